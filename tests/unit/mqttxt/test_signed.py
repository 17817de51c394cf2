"""The signed mode by rules (docs/protocol.md, section 12): who is heard, who is answered, and what a relay can do."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from typing import Any

import cbor2
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mqttxt.activator.role import Activator
from mqttxt.cli.main import _own_fog
from mqttxt.core.effects import Inbound, Log, Publish, Stop
from mqttxt.core.session_owners import MOST_OF_ONE, SessionOwners
from mqttxt.core.settings import Settings
from mqttxt.core.transport import Transport
from mqttxt.drone.grants import MOST_GRANTS, Grants
from mqttxt.errors import ConfigurationError, FogUnreachable, PayloadError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Goto, Hold, Offboard, Velocity
from mqttxt.protocol.messages import (
    BeaconMessage,
    CommandId,
    Control,
    DroneLease,
    FogPresence,
    FogResultMessage,
    Grant,
    Presence,
    Registration,
    ResultMessage,
    RosterEntry,
    Word,
)
from mqttxt.protocol.rankings import PsmiMessage, SelectMode
from mqttxt.security.addressed import Addressed
from mqttxt.security.cose import Envelope
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from mqttxt.security.seal import MOST_CERTIFICATES, Seal
from mqttxt.station.ground_station import GroundStation
from mqttxt.station.outcomes import Outcome
from mqttxt.station.role import StationRole
from tests.simulation.signing import ALL, authority, folder, seal
from tests.simulation.world import (
    FOG_SESSION,
    GS_SESSION,
    UAV_SESSION,
    World,
    ack,
    command_payload,
    heartbeat,
    landed,
    position,
    results,
)

OTHER_SESSION = 0x77


@pytest.fixture
def world() -> World:
    """A fog that signs, its drone under the control of station g."""
    made = World(signed=True).start()
    made.pass_time(1000)
    made.logs.clear()
    made.heard.clear()
    return made


def signed_command(by: Seal | None = None, topic: str = "drone1/commands", **changed: Any) -> Envelope:
    """Arm as station g signs it, in the drone's session, unless a test changes that."""
    fields = {"seq": 9, "deadline_ms": 5000, **changed}
    return (by or seal("gs-g")).sign(topic, encode(command_payload(fields.pop("command", Arm()), **fields)))


def to_drone(
    world: World, envelope: Envelope | bytes, topic: str = "drone1/commands", retain: bool = False
) -> list[Any]:
    payload = envelope if isinstance(envelope, bytes) else envelope.encode()
    return list(world.uav.on_message("fog", Inbound(topic, payload, 1, retain), world.now_ms))


def said(effects: list[Any]) -> list[tuple[Word, str | None]]:
    opened = [
        replace(effect, payload=Envelope.parse(effect.payload).payload)
        for effect in effects
        if isinstance(effect, Publish) and "/commands_result/" in effect.topic
    ]
    return [(result.word, result.reason) for result in results(opened)]


def kinds(effects: list[Any]) -> list[str]:
    return [effect.kind for effect in effects if isinstance(effect, Log)]


def outcomes(world: World) -> list[tuple[Word, str | None, str | None]]:
    return [(o.word, o.reason, o.signer) for o in world.heard if isinstance(o, Outcome)]


def last_sent(world: World, topic: str) -> Publish:
    return next(publish for _, publish in reversed(world.sent) if publish.topic == topic)


# Commands and their words, all the way.


def test_a_command_is_signed_for_the_drone_and_its_words_by_the_drone(world: World) -> None:
    world.send(Arm())
    assert len(world.wrote) == 1
    world.autopilot(ack(400), heartbeat(armed=True))
    assert outcomes(world) == [(Word.ACCEPTED, None, "drone1"), (Word.COMPLETED, None, "drone1")]
    sent, forwarded = (last_sent(world, topic).payload for topic in ("fog1/drone1/commands", "drone1/commands"))
    assert Addressed.parse(sent).entries[1].payload == Envelope.parse(forwarded).payload
    assert Addressed.parse(sent).entries[1].signature == Envelope.parse(forwarded).signature


def test_a_broadcast_carries_what_is_signed_for_each_and_a_drone_gets_its_own(world: World) -> None:
    world.send(Hold(), None)
    assert list(Addressed.parse(last_sent(world, "fog1/commands").payload).entries) == [1]
    assert Envelope.parse(last_sent(world, "drone1/commands").payload)
    assert len(world.wrote) == 1


def test_a_beacon_that_a_broker_moved_makes_no_drone_one_of_another_fog(world: World) -> None:
    world.gs.add_fogs([2])
    fog, topic = world.gs.fog(2), "fog2/drone1/clock"
    world.gs.on_message("cloud", Inbound(topic, last_sent(world, "fog1/drone1/clock").payload), world.now_ms)
    assert fog.drones[1].clock is not None
    fog.on_presence(FogPresence(session=5, up=True), world.now_ms)
    fog.on_beacon(BeaconMessage(session=5, now_ms=1), world.now_ms)
    fog.registered = True
    with pytest.raises(FogUnreachable, match="no signed beacon of a drone"):
        world.gs.commands.send(fog, None, Arm(), world.now_ms)
    with pytest.raises(FogUnreachable, match="no signed beacon of drone 1"):
        world.gs.commands.send(fog, 1, Arm(), world.now_ms)


def test_a_drone_that_a_broadcast_is_not_signed_for_is_denied(world: World) -> None:
    world.gs.fogs[1].drones[1].clock = None
    world.gs.fogs[1].on_drone_beacon(2, BeaconMessage(session=5, now_ms=1), world.now_ms)
    world.gs.fogs[1].drones[2].session = 5
    world.send(Hold(), None)
    assert (Word.DENIED, "not_signed", "fog1") in outcomes(world) or not world.wrote
    assert not world.wrote


def test_a_signed_drone_that_the_roster_leaves_out_is_told_of_and_waited_for(world: World) -> None:
    sent = world.gs.commands.send(world.gs.fog(1), None, Hold(), world.now_ms)[0]
    roster = FogResultMessage(
        gs_session=GS_SESSION, seq=sent.seq, session=FOG_SESSION, stamp=1, roster=(RosterEntry(drone=2),)
    )
    out = world.gs.commands.on_fog_result(world.gs.fog(1), roster, world.now_ms)
    assert kinds(out) == ["missing_from_roster"]
    assert world.gs.commands.pending[sent].roster == (2, 1)


def test_a_fog_that_denies_a_broadcast_and_hands_it_to_a_drone_is_told_of(world: World) -> None:
    """As does a broker that delivers one drone's part as a command of its own before: the rest conflicts with that."""
    sent, (publish,) = world.gs.commands.send(world.gs.fog(1), None, Arm(), world.now_ms)
    assert isinstance(publish, Publish)
    world.route("broker", replace(publish, topic="fog1/drone1/commands"))
    world.drop = {"arm"}
    world.route("broker", publish)
    assert len(world.wrote) == 1
    results_of_fog = [p for _, p in world.sent if p.topic == "fog1/commands_result/arm"]
    out = list(world.gs.on_message("cloud", Inbound(*_of(results_of_fog[-1])), world.now_ms))
    assert [(o.drone, o.word, o.reason, o.signer) for o in out if isinstance(o, Outcome)] == [
        (None, Word.DENIED, "id_conflict", "fog1")
    ]
    assert not world.gs.commands.pending[sent].is_open
    for said_word in (Word.ACCEPTED, Word.COMPLETED):
        out = hear(world, word("drone1", said_word, "drone1/commands_result/arm", seq=sent.seq))
        assert kinds(out) == ["contradicted"]
    assert [(o.drone, o.word, o.settled) for o in world.heard if isinstance(o, Outcome)] == [(1, Word.COMPLETED, True)]


def _of(publish: Publish) -> tuple[str, bytes, int]:
    return publish.topic, publish.payload, publish.qos


def test_without_a_signed_beacon_nothing_is_sent(world: World) -> None:
    world.gs.fogs[1].drones[1].clock = None
    with pytest.raises(FogUnreachable, match="no signed beacon of drone 1"):
        world.send(Arm())


def test_the_deadline_that_is_signed_holds_whatever_the_relay_says(world: World) -> None:
    for seq, route in enumerate((None, 2**40, world.now_ms + 3000), 9):
        late = signed_command(seq=seq, deadline_ms=world.now_ms - 1).routed(route)
        assert said(to_drone(world, late)) == [(Word.EXPIRED, None)]


def test_a_relay_can_make_a_deadline_earlier_and_what_it_refused_so_stays_refused(world: World) -> None:
    envelope = signed_command(deadline_ms=world.now_ms + 3000)
    assert said(to_drone(world, envelope.routed(0))) == [(Word.EXPIRED, None)]
    assert said(to_drone(world, envelope)) == [(Word.EXPIRED, None)]
    assert not world.wrote


def test_a_full_ledger_denies_until_what_was_signed_is_over_not_what_the_relay_says(world: World) -> None:
    world.uav.desk.ledger._capacity = 0
    world.uav.desk.executor.holder_session = GS_SESSION
    envelope = signed_command(deadline_ms=world.now_ms + 3000)
    assert said(to_drone(world, envelope.routed(0))) == [(Word.DENIED, "ledger_full")]
    world.uav.desk.ledger._capacity = 4096
    world.now_ms += 100
    assert said(to_drone(world, envelope)) == [(Word.DENIED, "ledger_full")]


@pytest.mark.parametrize("route", [-1, "soon", 1.5, [1], True])
def test_a_route_that_is_no_deadline_is_nobodys_command(world: World, route: Any) -> None:
    assert kinds(to_drone(world, signed_command().routed(route))) == ["malformed"]


def test_a_command_for_another_session_of_the_drone_only_asks(world: World) -> None:
    assert said(to_drone(world, signed_command(executor_session=OTHER_SESSION))) == [(Word.EXPIRED, None)]


# Before a signature verifies nothing is answered, and nothing is entered.


def forgeries() -> dict[str, Envelope | bytes]:
    mine = signed_command()
    return {
        "not signed": encode(command_payload(Arm(), seq=9)),
        "another payload": replace(mine, payload=encode(command_payload(Hold(), seq=9))),
        "for another drone": signed_command(topic="drone2/commands"),
        "another fleet's station": signed_command(seal("gs-g", fleet="other")),
        "an unknown station": signed_command(seal("gs-h")),
        "the activator": signed_command(seal("fog1")),
        "another drone": signed_command(seal("drone2")),
        "a signature of zeros": replace(mine, signature=b"\0" * 64),
        "with a certificate of another fleet": replace(
            signed_command(seal("gs-g", fleet="other")), certificate=seal("gs-g", fleet="other").certificate.der
        ),
        "with garbage for a certificate": replace(mine, certificate=b"garbage"),
    }


@pytest.mark.parametrize("what", forgeries())
def test_what_is_forged_is_neither_answered_nor_entered(world: World, what: str) -> None:
    out = to_drone(world, forgeries()[what])
    assert said(out) == []
    assert world.uav.desk.ledger.get(CommandId(GS_SESSION, 9)) is None
    assert kinds(out)[0] in ("not_signed", "unknown_signer", "forged", "certificate", "malformed")
    assert len([e for e in to_drone(world, signed_command()) if not isinstance(e, Log)]) == 1  # and the true one counts


def test_an_activator_answers_and_enters_nothing_forged(world: World) -> None:
    for what, forged in forgeries().items():
        entries = {1: forged} if isinstance(forged, Envelope) else {}
        payload = Addressed(FOG_SESSION, world.now_ms + 5000, entries).encode()
        out = world.activator.on_message("cloud", Inbound("fog1/drone1/commands", payload, 1), world.now_ms)
        assert [effect for effect in out if not isinstance(effect, Log)] == [], what
        assert world.activator.relay.ledger.get(CommandId(GS_SESSION, 9)) is None


def test_a_malformed_command_of_a_station_is_answered(world: World) -> None:
    row = b"\x87\x01\x18\x11\x09\x18\x33\x19\x13\x88\x18\x64\x00"
    out = to_drone(world, seal("gs-g").sign("drone1/commands", row))
    assert [word for word, _ in said(out)] == [Word.DENIED]
    payload = Addressed(FOG_SESSION, 9999, {1: seal("gs-g").sign("drone1/commands", row)}).encode()
    out = list(world.activator.on_message("cloud", Inbound("fog1/drone1/commands", payload, 1), world.now_ms))
    assert [word for word, _ in said(out)] == [Word.DENIED]


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\x80",
        Addressed(1, 1, {}).encode(),
        Addressed(1, 1, {2: signed_command(topic="drone2/commands")}).encode(),
        b"\x84\x02\x01\x01\x80",
        b"\x84\x01\x01\x01\x81\x80",
        b"\x84\x01\x20\x01\x80",
        b"\x85\x01\x01\x01\x80\x20",
    ],
    ids=range(8),
)
def test_what_is_not_addressed_as_it_should_is_dropped(world: World, payload: bytes) -> None:
    out = list(world.activator.on_message("cloud", Inbound("fog1/drone1/commands", payload, 1), world.now_ms))
    assert [type(effect) for effect in out] == [Log]


# Ids belong to signers; rights are the drone's to look at.


def meet(world: World, station: Seal, session: int) -> None:
    """The drone hears of another station, as its activator passes it on."""
    topic = f"gs/{station.certificate.node.label}/reachable"
    birth = station.sign(topic, encode(Presence(session=session, up=True)), with_certificate=True)
    out = world.uav.on_message("fog", Inbound("drone1/stations", birth.encode(), 1), world.now_ms)
    world.logs += [effect for effect in out if isinstance(effect, Log)]


def test_nobody_uses_another_stations_session(world: World) -> None:
    meet(world, seal("gs-h"), GS_SESSION)
    assert [log.kind for log in world.logs] == ["foreign_session"]
    out = to_drone(world, signed_command(seal("gs-h"), seq=2**32 - 1))
    assert (said(out), kinds(out)) == ([], ["foreign_session"])
    assert said(to_drone(world, signed_command(seq=10))) == []
    assert len([e for e in to_drone(world, signed_command(seq=11)) if not isinstance(e, Log)]) == 1


def test_a_session_that_no_birth_has_named_is_not_heard(world: World) -> None:
    assert kinds(to_drone(world, signed_command(gs_session=OTHER_SESSION))) == ["foreign_session"]


def test_a_station_forgets_its_own_oldest_sessions_alone() -> None:
    owners = SessionOwners()
    assert owners.claim(1, "gs-a")
    for session in range(100, 100 + MOST_OF_ONE + 1):
        assert owners.claim(session, "gs-b")
    assert owners.is_of(1, "gs-a")
    assert not owners.is_of(100, "gs-b")
    assert not owners.claim(1, "gs-b")


def test_a_station_that_runs_on_is_not_forgotten_for_those_that_came_and_went() -> None:
    owners = SessionOwners()
    for session in range(100, 100 + 2 * MOST_OF_ONE):
        assert owners.claim(1, "gs-a")
        assert owners.claim(session, "gs-a")
    assert owners.is_of(1, "gs-a")


def test_the_drone_looks_at_rights_itself_and_names_the_one_that_is_missing(world: World) -> None:
    watcher = seal("gs-watcher", Rights(command=frozenset({2}), observe=True))
    meet(world, watcher, OTHER_SESSION)
    out = to_drone(world, signed_command(watcher, gs_session=OTHER_SESSION))
    assert said(out) == [(Word.DENIED, "not_allowed, mqttxt:may/command/1")]
    assert world.uav.desk.ledger.get(CommandId(OTHER_SESSION, 9)) is not None


def test_a_station_without_the_right_says_so_before_it_sends() -> None:
    world = World(signed=True)
    world.gs = StationRole("w", GS_SESSION, Settings(), seal=seal("gs-w", Rights(command=frozenset({2}))))
    world.start().pass_time(1000)
    with pytest.raises(ConfigurationError, match="mqttxt:may/command/1"):
        world.send(Arm())
    assert not world.activator.leases.controls(GS_SESSION, 1)


def revoked(name: str) -> Seal:
    """A fleet of its own, whose station was revoked after everybody had met it."""
    return seal(name, fleet="revoking")


def test_who_is_revoked_is_not_heard_from_the_moment_on_that_the_list_is_here() -> None:
    station, drone = revoked("gs-r"), revoked("drone1")
    sent = station.sign("drone1/commands", b"x", with_certificate=True)
    assert drone.open_of_station("drone1/commands", sent).signer == "gs-r"
    authority("revoking").revoke("gs-r")
    drone.identity.fleet.replace((authority("revoking").folder / "revoked.pem").read_bytes())
    with pytest.raises(PayloadError, match="revoked"):
        drone.open_of_station("drone1/commands", sent.bare())


def test_of_one_name_the_newest_certificates_are_kept() -> None:
    receiver, fleet = seal("drone1", fleet="renewing"), authority("renewing")
    folder("gs-n", ALL, "renewing")
    old = Seal(Identity.load(fleet.folder / "gs-n"))
    assert receiver.open_of_station("t", old.sign("t", b"x", with_certificate=True))
    for _ in range(MOST_CERTIFICATES):
        fleet.renew("gs-n")
        new = Seal(Identity.load(fleet.folder / "gs-n"))
        assert receiver.open_of_station("t", new.sign("t", b"x", with_certificate=True)).signer == "gs-n"
    with pytest.raises(PayloadError, match="expected one of a known certificate"):
        receiver.open_of_station("t", old.sign("t", b"x"))


def test_a_certificate_that_ends_in_flight_still_holds_lands_and_returns() -> None:
    fleet, now_s = authority("ending"), time.time()
    for name, rights, days in (
        ("gs-g", ALL, 1.0),
        ("gs-new", ALL, 1.0),
        ("drone1", Rights(), 90.0),
        ("fog1", Rights(), 90.0),
    ):
        fleet.issue(name, rights, days)
    seals = {
        name: Seal(Identity.load(fleet.folder / name, system=lambda: now_s))
        for name in ("gs-g", "gs-new", "drone1", "fog1")
    }
    world = World(signed=True, seal=seals.get).start()
    world.pass_time(1000)
    now_s += 2 * 86_400
    world.autopilot(heartbeat(armed=True), landed(2), position(10.0))
    world.send(Arm())
    assert outcomes(world) == [(Word.DENIED, "certificate_expired", "fog1")]
    assert said(to_drone(world, signed_command(seals["gs-g"]))) == [(Word.DENIED, "certificate_expired")]
    world.pass_time(40_000)
    world.autopilot(heartbeat(armed=True), landed(2), position(10.0))
    world.send(Hold())
    assert len(world.wrote) == 1
    late = seals["gs-new"].sign("drone1/commands", b"x", with_certificate=True).encode()
    assert kinds(to_drone(world, late)) == ["certificate"]
    fields = {"name": "new", "session": 5, "nonce": 1, "lease_s": 30, "activator_session": FOG_SESSION, "counter": 1}
    new = seals["gs-new"].sign("fog1/init_connect", encode(Registration(**fields)), with_certificate=True)
    out = world.activator.on_message("cloud", Inbound("fog1/init_connect", new.encode(), 1), world.now_ms)
    assert kinds(list(out)) == ["certificate"]


# Words: the drone's are the drone's, and an activator's are marked.


def word(by: str, said_word: Word, topic: str, session: int = UAV_SESSION, seq: int = 1) -> bytes:
    result = ResultMessage(gs_session=GS_SESSION, seq=seq, session=session, stamp=1, word=said_word)
    return seal(by).sign(topic, encode(result)).routed([1, False]).encode()


def hear(world: World, payload: bytes) -> list[Any]:
    out = world.gs.on_message("cloud", Inbound("fog1/drone1/commands_result/arm", payload, 1), world.now_ms)
    world.heard += [effect for effect in out if isinstance(effect, Outcome)]
    return list(out)


def test_an_activator_says_by_itself_only_what_was_not_done(world: World) -> None:
    world.drop = {"commands"}
    world.send(Arm())
    for lie in (Word.ACCEPTED, Word.COMPLETED, Word.FAILED, Word.SUPERSEDED, Word.OVERTAKEN):
        assert kinds(hear(world, word("fog1", lie, "fog1/drone1/commands_result/arm"))) == ["forged"]
    hear(world, word("fog1", Word.UNREACHABLE, "fog1/drone1/commands_result/arm"))
    assert outcomes(world) == [(Word.UNREACHABLE, None, "fog1")]


def test_a_drones_word_against_its_activators_is_told(world: World) -> None:
    world.drop = {"commands"}
    world.send(Arm())
    hear(world, word("fog1", Word.UNREACHABLE, "fog1/drone1/commands_result/arm"))
    assert kinds(hear(world, word("drone1", Word.ACCEPTED, "drone1/commands_result/arm"))) == ["contradicted"]
    assert kinds(hear(world, word("drone1", Word.COMPLETED, "drone1/commands_result/arm"))) == ["contradicted"]
    assert hear(world, word("drone1", Word.COMPLETED, "drone1/commands_result/arm")) == []
    settled = [o for o in world.heard if isinstance(o, Outcome) and o.settled]
    assert [(o.word, o.signer) for o in settled] == [(Word.COMPLETED, "drone1")]


@pytest.mark.parametrize(
    ("by", "topic"),
    [
        ("drone2", "drone1/commands_result/arm"),
        ("drone1", "drone2/commands_result/arm"),
        ("drone1", "drone1/commands_result/land"),
        ("fog2", "fog1/drone1/commands_result/arm"),
        ("fog1", "drone1/commands_result/arm"),
        ("gs-h", "drone1/commands_result/arm"),
    ],
)
def test_nobody_elses_word_counts(world: World, by: str, topic: str) -> None:
    world.drop = {"commands"}
    world.send(Arm())
    assert kinds(hear(world, word(by, Word.DENIED, topic)))[0] in ("forged", "unknown_signer")
    assert outcomes(world) == []
    payload = word(by, Word.DENIED, topic)
    out = world.activator.on_message("fog", Inbound("drone1/commands_result/arm", payload, 1), world.now_ms)
    assert kinds(list(out))[0] in ("forged", "unknown_signer")


def test_a_broker_that_says_that_nobody_subscribes_is_not_believed(world: World) -> None:
    world.drop = {"commands"}
    sent = world.gs.commands.send(world.gs.fog(1), 1, Arm(), world.now_ms)
    world.drop = set()
    (publish,) = sent[1]
    assert isinstance(publish, Publish)
    out = world.activator.on_message("cloud", Inbound(publish.topic, publish.payload, 1), world.now_ms)
    (forwarded,) = [e for e in out if isinstance(e, Publish) and e.topic == "drone1/commands"]
    assert list(world.activator.on_published("fog", forwarded.ref, 0x10, world.now_ms)) == []


@pytest.mark.parametrize("route", [None, [1], [1, 2], ["x", True], [-1, False], [2**16, False], 7])
def test_what_a_relay_says_beside_a_word_is_read_strictly(world: World, route: Any) -> None:
    world.drop = {"commands"}
    world.send(Arm())
    payload = Envelope.parse(word("drone1", Word.DENIED, "drone1/commands_result/arm")).routed(route).encode()
    assert kinds(hear(world, payload)) == ["malformed"]


# Registrations, control, leases, grants.


def registration(world: World, by: Seal, **changed: Any) -> list[Any]:
    fields: dict[str, Any] = {
        "name": by.certificate.node.label,
        "session": OTHER_SESSION,
        "nonce": 1,
        "lease_s": 30,
        "control": Control.WANT,
        "until_ms": world.now_ms + 20_000,
        "activator_session": FOG_SESSION,
        "counter": 5,
    }
    payload = by.sign("fog1/init_connect", encode(Registration(**{**fields, **changed})), with_certificate=True)
    return list(world.activator.on_message("cloud", Inbound("fog1/init_connect", payload.encode(), 1), world.now_ms))


@pytest.mark.parametrize(
    "changed",
    [
        {"name": "g"},
        {"session": GS_SESSION},
        {"activator_session": OTHER_SESSION},
        {"activator_session": None},
        {"counter": None},
        {"until_ms": None},
        {"until_ms": 1},
    ],
)
def test_a_registration_names_its_signer_this_session_an_end_and_a_counter(
    world: World, changed: dict[str, Any]
) -> None:
    out = registration(world, seal("gs-h"), **changed)
    assert kinds(out)[0] in ("foreign_session", "old_registration")
    assert len(world.activator.leases) == 1


def test_an_old_registration_is_not_heard_and_ends_nothing_either(world: World) -> None:
    station = seal("gs-h")
    assert kinds(registration(world, station, counter=5)) == []
    assert kinds(registration(world, station, counter=5)) == ["old_registration"]
    assert kinds(registration(world, station, counter=4, lease_s=0)) == ["old_registration"]
    assert len(world.activator.leases) == 2
    assert kinds(registration(world, station, counter=6, lease_s=0)) == []
    assert len(world.activator.leases) == 1
    assert kinds(registration(world, station, counter=5)) == ["old_registration"]
    assert len(world.activator.leases) == 1


def test_an_old_birth_of_an_activator_that_a_broker_repeats_frees_no_control(world: World) -> None:
    """The station then has no beacon of the session, and asks for one: that is no end of its lease."""
    birth = last_sent(world, "fog1/reachable")
    old = seal("fog1").sign(birth.topic, encode(FogPresence(session=OTHER_SESSION, up=True))).encode()
    for payload in (old, birth.payload):
        world.run("gs", world.gs.on_message("cloud", Inbound(birth.topic, payload, 1), world.now_ms))
        assert world.activator.leases.controls(GS_SESSION, 1)
    world.pass_time(100)
    assert world.gs.fogs[1].registered
    world.run("gs", world.gs.goodbye(world.now_ms))
    assert not world.activator.leases


def test_a_beacon_confirms_one_registration(world: World) -> None:
    beacon = last_sent(world, "fog1/clock")
    world.gs.on_disconnected("cloud", world.now_ms)
    fog = world.gs.fogs[1]
    fog.up = True
    world.gs.on_message("cloud", Inbound("fog1/clock", beacon.payload), world.now_ms)
    assert not fog.registered


def test_one_station_leaves_room_for_others(world: World) -> None:
    for session in range(1000, 1000 + MOST_OF_ONE):
        assert kinds(registration(world, seal("gs-h"), session=session)) == []
    assert kinds(registration(world, seal("gs-h"), session=2000)) == ["too_many_stations"]
    assert len(world.activator.leases) == 1 + MOST_OF_ONE
    assert kinds(registration(world, seal("gs-new"))) == []
    assert kinds(registration(world, seal("gs-h"), session=1000, counter=6)) == []


@pytest.mark.parametrize("is_record_first", [True, False])
def test_nobody_takes_the_session_that_controls_a_drone_while_its_activator_starts(
    world: World, is_record_first: bool
) -> None:
    birth = seal("gs-h").sign("gs/h/reachable", encode(Presence(session=GS_SESSION, up=True)), with_certificate=True)
    record = last_sent(world, "fog1/drone1/reachable")
    retained = [(record.topic, record.payload), ("gs/h/reachable", birth.encode())]
    started = Activator(1, 0x99, Settings(), drones=(1,), seal=seal("fog1"))
    for topic, payload in retained if is_record_first else reversed(retained):
        started.on_message("cloud", Inbound(topic, payload, 1, True), 0)
    assert started._owners.claim(GS_SESSION, "gs-g")
    assert not started._owners.claim(GS_SESSION, "gs-h")


def test_control_follows_rights(world: World) -> None:
    two = seal("gs-two", Rights(command=frozenset({2})))
    registration(world, two, drones=(1, 2))
    assert not world.activator.leases.controls(OTHER_SESSION, 1)
    registration(world, two, control=Control.TAKE, counter=6, epoch=100)
    assert world.activator.leases.controls(GS_SESSION, 1)
    lease = world.activator.leases._leases["two", OTHER_SESSION]
    assert lease.drones == frozenset({2})


def test_a_takeover_takes_a_right_and_a_registration(world: World) -> None:
    polite = seal("gs-polite", Rights(command=None))
    registration(world, polite)
    registration(world, polite, control=Control.TAKE, counter=6, epoch=100)
    assert world.activator.leases.controls(GS_SESSION, 1)
    taker = seal("gs-h")
    registration(world, taker, session=0x88, control=Control.TAKE, epoch=100)
    assert world.activator.leases.controls(GS_SESSION, 1)
    registration(world, taker, session=0x88, control=Control.TAKE, counter=6, epoch=100)
    assert world.activator.leases.controls(0x88, 1)


def test_a_takeover_is_told_to_everybody(world: World) -> None:
    taker = World(signed=True)
    taker.gs = StationRole("h", OTHER_SESSION, Settings(), seal=seal("gs-h"))
    world.subscribed = [entry for entry in world.subscribed if entry[0] != "gs"]
    world.gs = taker.gs
    world.gs.add_fogs([1])
    world.run("gs", world.gs.on_connected("cloud", world.now_ms))
    world.pass_time(1000)
    world.run("gs", world.gs.take_over(1, None, world.now_ms))
    world.pass_time(1000)
    assert world.gs.fogs[1].controls(1)
    world.send(Arm())
    assert len(world.wrote) == 1


def test_a_will_frees_no_control(world: World) -> None:
    will = world.gs.will()
    out = world.activator.on_message("cloud", Inbound(will.topic, will.payload, 1), world.now_ms)
    assert list(out) == []
    assert world.activator.leases.controls(GS_SESSION, 1)


def lease(by: str, **changed: Any) -> Envelope:
    fields = {"activator_session": FOG_SESSION, "drone_session": UAV_SESSION, "nonce": 1, "bound": True, **changed}
    return seal(by).sign("drone1/init_connect", encode(DroneLease(**fields)), with_certificate=True)


def test_a_drone_takes_leases_of_its_own_fog_alone(world: World) -> None:
    for by in ("fog2", "gs-g", "drone1"):
        out = world.uav.on_message("fog", Inbound("drone1/init_connect", lease(by, bound=False).encode(), 1), 2000)
        assert kinds(list(out))[0] in ("unknown_signer", "certificate", "forged"), by
    out = world.uav.on_message("fog", Inbound("drone1/init_connect", lease("fog1", bound=False).encode(), 1), 2000)
    assert [type(effect) for effect in out] == [Stop]


def test_no_activator_makes_control_last_longer_than_its_station_has_granted(world: World) -> None:
    wide = lease("fog1", holder_session=GS_SESSION, deadline_ms=2**40, offboard_until_ms=2**40)
    world.uav.on_message("fog", Inbound("drone1/init_connect", wide.encode(), 1), world.now_ms)
    until_ms = world.uav.desk.executor.lease_until_ms
    assert until_ms is not None
    assert world.now_ms < until_ms <= world.now_ms + 30_000
    assert world.uav.desk.executor.offboard_until_ms == 0
    nobodys = lease("fog1", holder_session=OTHER_SESSION, deadline_ms=2**40, offboard_until_ms=2**40)
    world.uav.on_message("fog", Inbound("drone1/init_connect", nobodys.encode(), 1), world.now_ms)
    assert not world.uav.is_controlled(world.now_ms)


def test_an_offboard_command_lives_by_its_stations_grants(world: World) -> None:
    world.autopilot(heartbeat(armed=True), landed(2), position(10.0))
    world.send(Offboard(60.0, velocity=Velocity(1.0, 0.0, 0.0)))
    world.pass_time(3000)
    offboard_ms = world.uav.desk.executor.offboard_until_ms
    assert offboard_ms is not None
    assert world.now_ms < offboard_ms <= world.now_ms + 3000
    world.drop, dropped_ms = {"control"}, world.now_ms
    allowed: list[int] = []
    while world.now_ms < dropped_ms + 6000:
        world.pass_time(100)
        allowed.append(world.uav.desk.executor.offboard_until_ms or 0)
    assert dropped_ms < max(allowed) <= dropped_ms + 3000


def test_a_grant_is_its_own_stations_and_never_goes_back(world: World) -> None:
    def grant(by: Seal, **changed: Any) -> list[Any]:
        fields = {"gs_session": GS_SESSION, "drone_session": UAV_SESSION, "until_ms": 10**6, **changed}
        payload = by.sign("drone1/control", encode(Grant(**fields))).encode()
        return list(world.uav.on_message("fog", Inbound("drone1/control", payload, 1), world.now_ms))

    meet(world, seal("gs-h"), OTHER_SESSION)
    assert kinds(grant(seal("gs-h"))) == ["foreign_session"]
    before_ms = world.uav.desk.executor.lease_until_ms
    grant(seal("gs-g"), until_ms=1)
    grant(seal("gs-g"), drone_session=5)
    assert world.uav.desk.executor.lease_until_ms == before_ms
    out = world.activator.on_message(
        "cloud",
        Inbound("fog1/drone1/control", seal("gs-h").sign("drone1/control", b"\x80").encode(), 1),
        world.now_ms,
    )
    assert kinds(list(out))


def test_grants_are_bounded() -> None:
    grants = Grants()
    for session in range(1, MOST_GRANTS + 2):
        grants.take(Grant(gs_session=session, drone_session=1, until_ms=9, offboard_until_ms=5))
    assert grants.bound(1, 100, 100) == (None, None)
    assert grants.bound(2, 100, None) == (9, None)
    assert grants.bound(None, 100, 100) == (None, None)


# Births, presence, beacons.


def test_a_restarted_activator_hears_everybody_again_and_commands_go_on(world: World) -> None:
    world.restart_activator(0x99)
    world.pass_time(6000)
    world.send(Arm())
    assert len(world.wrote) == 1


def test_a_restarted_drone_is_commanded_in_its_new_session(world: World) -> None:
    world.restart_uav(0x98, [])
    world.pass_time(6000)
    world.send(Arm())
    assert len(world.wrote) == 1
    assert outcomes(world) == []


@pytest.mark.parametrize("topic", ["fog1/reachable", "fog1/drone1/reachable", "gs/g/reachable", "drone1/reachable"])
def test_what_somebody_else_retains_is_put_right(world: World, topic: str) -> None:
    link = "fog" if topic.startswith("drone") else "cloud"
    before = world.retained[link, topic].payload
    world.route("somebody", Publish(link, topic, b"\x83\x01\x05\xf4", 0, retain=True))
    world.pass_time(1500)
    assert decode_signed(world.retained[link, topic].payload) == decode_signed(before)


def decode_signed(payload: bytes) -> bytes:
    return Envelope.parse(payload).payload


def test_beacons_are_the_drones_own_at_activator_and_station(world: World) -> None:
    ahead = encode(BeaconMessage(session=UAV_SESSION, now_ms=10**9))
    clock = world.gs.fogs[1].drones[1].clock
    assert clock is not None
    before = clock.deadline_ms(world.now_ms, 0)
    for by, topic in (("fog1", "drone1/clock"), ("drone2", "drone1/clock"), ("drone1", "drone1/state/clock")):
        payload = seal(by).sign(topic, ahead).encode()
        assert kinds(list(world.gs.on_message("cloud", Inbound("fog1/drone1/clock", payload), world.now_ms)))
        assert kinds(list(world.activator.on_message("fog", Inbound("drone1/clock", payload), world.now_ms)))
    assert clock.deadline_ms(world.now_ms, 0) == before


def test_an_old_echo_does_not_refuse_a_newcomer(world: World) -> None:
    echo = next(publish for _, publish in world.sent if publish.topic == "drone1/clock")
    birth = seal("drone1").sign("drone1/reachable", encode(Presence(session=0x44, up=True)), with_certificate=True)
    world.activator.on_message("fog", Inbound("drone1/reachable", birth.encode(), 1), world.now_ms)
    out = world.activator.on_message("fog", Inbound("drone1/clock", echo.payload), world.now_ms)
    leases = [e for e in out if isinstance(e, Publish) and e.topic == "drone1/init_connect"]
    assert leases == []


def test_a_starting_activator_is_stopped_by_an_answer_not_by_an_old_beacon() -> None:
    rival = Activator(1, FOG_SESSION, Settings(), seal=seal("fog1"))
    new = Activator(1, 0x55, Settings(), seal=seal("fog1"))
    for subscribe in new.on_connected("cloud", 0):
        new.on_subscribed(subscribe, 0)  # type: ignore[arg-type]
    presence = encode(FogPresence(session=FOG_SESSION, up=True))
    retained = seal("fog1").sign("fog1/reachable", presence).encode()
    new.on_message("cloud", Inbound("fog1/reachable", retained, 1, True), 0)
    own = seal("fog1").sign("fog1/clock", encode(BeaconMessage(session=0x55, now_ms=0))).encode()
    (question,) = [e for e in new.on_message("cloud", Inbound("fog1/clock", own), 0) if isinstance(e, Publish)]
    old = seal("fog1").sign("fog1/clock", encode(BeaconMessage(session=FOG_SESSION, now_ms=5, nonce=3, held_ms=0)))
    assert list(new.on_message("cloud", Inbound("fog1/clock", old.encode()), 1)) == []
    rival.born = True
    answer = [
        e for e in rival.on_message("cloud", Inbound(question.topic, question.payload, 1), 9) if isinstance(e, Publish)
    ]
    assert [type(e) for e in new.on_message("cloud", Inbound("fog1/clock", answer[-1].payload), 10)] == [Stop]


def test_a_restarted_fogs_presence_says_that_commands_must_be_signed(world: World) -> None:
    presence = decode(FogPresence, decode_signed(last_sent(world, "fog1/reachable").payload))
    assert presence.authenticated is True


@pytest.mark.parametrize("topic", ["drone1/reachable", "drone1/clock", "gs/g/reachable"])
def test_nothing_that_somebody_adds_to_a_message_is_passed_on(world: World, topic: str) -> None:
    signer = "gs-g" if topic.startswith("gs") else "drone1"
    message = (
        BeaconMessage(session=UAV_SESSION, now_ms=5) if "clock" in topic else Presence(session=GS_SESSION, up=True)
    )
    padded = seal(signer).sign(topic, encode(message), with_certificate=True).routed(b"\0" * 50_000)
    link = "cloud" if topic.startswith("gs") else "fog"
    out = list(world.activator.on_message(link, Inbound(topic, padded.encode(), 1), world.now_ms))
    assert [type(effect) for effect in out] == [Log]


# A choice of a drone.

TARGET = Goto(47.3978, 8.5456, 12.0)


def test_no_fog_chooses_by_itself(world: World) -> None:
    with pytest.raises(ConfigurationError, match="an offer and a commit"):
        world.gs.commands.select(world.gs.fog(1), TARGET, world.now_ms)
    select = world.gs.commands._channel.payload  # as a station of another make would sign it
    from mqttxt.protocol.rankings import SelectMessage

    message = SelectMessage(
        gs_session=GS_SESSION,
        seq=50,
        executor_session=FOG_SESSION,
        deadline_ms=world.now_ms + 5000,
        limit_s=60.0,
        mode=SelectMode.SELECT,
        command=TARGET,
    )
    inbound = Inbound("fog1/commands/goto", select("fog1/commands/goto", message), 1)
    assert kinds(list(world.activator.on_message("cloud", inbound, world.now_ms))) == ["not_signed"]


def test_a_commit_is_signed_for_the_drone_that_was_offered(world: World) -> None:
    held = world.activator.selector
    offer, outputs = world.gs.commands.select(
        world.gs.fog(1), TARGET, world.now_ms, mode=SelectMode.OFFER, limit_s=30.0
    )
    world.run("gs", outputs)
    answer = decode(PsmiMessage, decode_signed(last_sent(world, "fog1/PSMI").payload))
    assert answer.id == offer
    from mqttxt.activator.selector import Reservation

    held._reservations[offer] = Reservation(1, TARGET, world.now_ms + 30_000)
    _, outputs = world.gs.commands.select(
        world.gs.fog(1), TARGET, world.now_ms, mode=SelectMode.COMMIT, reservation=offer.seq, drone=1
    )
    world.run("gs", outputs)
    forwarded = Envelope.parse(last_sent(world, "drone1/commands").payload)
    assert forwarded.signature == Addressed.parse(last_sent(world, "fog1/commands/goto").payload).entries[1].signature


# What is set where the node is.


def test_signing_takes_an_identity_and_a_drone_its_fog() -> None:
    with pytest.raises(ConfigurationError, match="--signed: expected --identity DIR beside it"):
        Transport().seal(True)
    with pytest.raises(ConfigurationError, match="--signed: expected --identity DIR beside it"):
        GroundStation("mqtt://127.0.0.1", signed=True)
    with pytest.raises(ConfigurationError, match="--signed: expected --fog X"):
        _own_fog(None, True)
    with pytest.raises(ConfigurationError, match="--fog 3: expected --signed beside it"):
        _own_fog(3, False)
    with pytest.raises(ConfigurationError, match="--fog 0"):
        _own_fog(0, True)
    assert (_own_fog(3, True), _own_fog(None, False)) == (3, 0)


def test_a_fog_is_ready_when_its_drones_have_said_what_their_clocks_read(world: World) -> None:
    fog = world.gs.fogs[1]
    assert fog.is_ready(world.now_ms)
    fog.drones[1].clock = None
    fog._confirmed_ms = world.now_ms
    assert not fog.is_ready(world.now_ms)
    assert fog.is_ready(world.now_ms + 2000)  # one that is gone keeps nobody waiting
    fog.registered = False
    assert not fog.is_ready(world.now_ms + 2000)


# Whatever comes, nobody fails by it.

PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**40), 2**64 - 1)
    | st.floats()
    | st.binary(max_size=70)
    | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=5) | st.dictionaries(st.sampled_from([1, 4, 33, -65537, "x"]), inner, max_size=4)
    ),
    max_leaves=12,
)
ENVELOPES = st.tuples(
    st.just(b"\xa1\x01\x27"),
    st.fixed_dictionaries(
        {4: st.sampled_from([seal(name).certificate.hash[:4] for name in ("gs-g", "fog1", "drone1")])},
        optional={33: st.binary(max_size=40), -65537: PLAIN},
    ),
    st.binary(max_size=40),
    st.binary(min_size=64, max_size=64),
).map(list)
ADDRESSED = st.tuples(
    st.just(1),
    st.integers(0, 2**32),
    st.integers(0, 2**54),
    st.lists(st.tuples(st.integers(0, 251), ENVELOPES | PLAIN).map(list), max_size=3),
).map(list)
TOPICS = {
    "uav": [
        f"drone1/{rest}" for rest in ("commands", "init_connect", "reachable", "stations", "control", "sensor_ack")
    ],
    "activator": [
        *(f"fog1/{rest}" for rest in ("init_connect", "reachable", "clock", "commands", "commands/goto")),
        *(f"fog1/drone1/{rest}" for rest in ("commands", "reachable", "control")),
        "gs/g/reachable",
        "drone1/reachable",
        "drone1/clock",
        "drone1/commands_result/arm",
    ],
    "gs": [
        *(f"fog1/{rest}" for rest in ("clock", "reachable", "QoDS", "PSMI", "commands_result/arm")),
        *(f"fog1/drone1/{rest}" for rest in ("birth", "clock", "reachable", "commands_result/arm")),
        "gs/g/reachable",
    ],
}


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(role=st.sampled_from(sorted(TOPICS)), payload=PLAIN | ENVELOPES | ADDRESSED, data=st.data())
def test_nobody_fails_by_what_is_not_signed(role: str, payload: Any, data: st.DataObject) -> None:
    world = _running()
    topic = data.draw(st.sampled_from(TOPICS[role]))
    link = "fog" if topic.startswith("drone") else "cloud"
    out = getattr(world, role).on_message(link, Inbound(topic, cbor2.dumps(payload), 1), world.now_ms)
    assert not [effect for effect in out if isinstance(effect, Publish) and not effect.topic.endswith("/reachable")]


@cache
def _running() -> World:
    made = World(signed=True).start()
    made.pass_time(1000)
    return made
