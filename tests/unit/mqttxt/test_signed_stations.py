"""Signed stations (docs/protocol.md, section 12): sessions, rights, certificates, and whose words count."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import pytest

from mqttxt.core.effects import Inbound, Log, Publish
from mqttxt.core.session_owners import MOST_OF_ONE, SessionOwners
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import Journal
from mqttxt.errors import ConfigurationError, PayloadError
from mqttxt.protocol.bulk import BulkAsk, Get, Put
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Goto, Hold
from mqttxt.protocol.control import Registration
from mqttxt.protocol.messages import CommandId, FogResultMessage, Word
from mqttxt.protocol.plans import hash_of
from mqttxt.protocol.rankings import SelectMode
from mqttxt.protocol.readings import ReadingAck
from mqttxt.security.addressed import Addressed
from mqttxt.security.authority import Authority
from mqttxt.security.cose import Envelope
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from mqttxt.security.seal import MOST_CERTIFICATES, Seal
from mqttxt.station.outcomes import Outcome
from mqttxt.station.role import StationRole
from tests.simulation.carrying import reading
from tests.simulation.signed import (
    OTHER_SESSION,
    chosen,
    hear,
    kinds,
    meet,
    outcomes,
    said,
    signed_command,
    to_drone,
    word,
)
from tests.simulation.signing import ALL, authority, folder, seal
from tests.simulation.world import FOG_SESSION, GS_SESSION, World, heartbeat, landed, position


def test_nobody_uses_another_stations_session(world: World) -> None:
    meet(world, seal("gs-h"), GS_SESSION)
    assert [log.kind for log in world.logs] == ["foreign_session"]
    out = to_drone(world, signed_command(seal("gs-h"), seq=2**32 - 1))
    assert (said(out), kinds(out)) == ([], ["foreign_session"])
    assert said(to_drone(world, signed_command(seq=10))) == []
    assert any(isinstance(e, Journal) for e in to_drone(world, signed_command(seq=11)))


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
    world.start(1000)
    with pytest.raises(ConfigurationError, match="mqttxt:may/command/1"):
        world.send(Arm())
    assert not world.activator.leases.controls(GS_SESSION, 1)


def take_list(node: Seal, fleet: str) -> None:
    """The node has its fleet's newest revocation list."""
    assert node.identity.fleet.take(authority(fleet).fleet.revoked)


def revoked(name: str) -> Seal:
    """A fleet of its own, whose station was revoked after everybody had met it."""
    return seal(name, fleet="revoking")


def test_who_is_revoked_is_not_heard_from_the_moment_on_that_the_list_is_here() -> None:
    station, drone = revoked("gs-r"), revoked("drone1")
    sent = station.sign("drone1/commands", b"x", with_certificate=True)
    assert drone.open_of_station("drone1/commands", sent).signer == "gs-r"
    authority("revoking").revoke("gs-r")
    take_list(drone, "revoking")
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


def ending_fleet(name: str, *stations: str) -> Authority:
    """A fleet whose stations' certificates end before all others."""
    fleet = authority(name)
    for station in stations:
        fleet.issue(station, ALL, 1.0)
    for node in ("drone1", "fog1"):
        fleet.issue(node, Rights(), 90.0)
    return fleet


def test_a_certificate_that_ends_in_flight_still_holds_lands_and_returns() -> None:
    fleet, now_s = ending_fleet("ending", "gs-g", "gs-new"), time.time()
    seals = {
        name: Seal(Identity.load(fleet.folder / name, system=lambda: now_s))
        for name in ("gs-g", "gs-new", "drone1", "fog1")
    }
    world = World(signed=True, seal=seals.get).start(1000)
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
    assert kinds(world.hears("activator", "fog1/init_connect", new.encode())) == ["certificate"]


@pytest.fixture(scope="module")
def ending() -> Authority:
    return ending_fleet("ending-soon", "gs-g")


@dataclass
class Ended:
    """A world where station g has control of drone 1, and its certificate has ended; `seal` is what it signs with."""

    world: World
    seal: Seal

    def hear(self, topic: str, signed_as: str, message: object) -> tuple[list[str], list[Any]]:
        """What drone and activator make of a message: what they count, and what else they do."""
        envelope = self.seal.sign(signed_as, encode(message)).encode()
        node, link = (self.world.activator, "cloud") if topic.startswith("fog") else (self.world.uav, "fog")
        out = list(node.on_message(link, Inbound(topic, envelope, 1), self.world.now_ms))
        return kinds(out), [effect for effect in out if not isinstance(effect, Log)]


@pytest.fixture
def ended(ending: Authority) -> Ended:
    now_s = time.time()
    seals = {
        name: Seal(Identity.load(ending.folder / name, system=lambda: now_s)) for name in ("gs-g", "drone1", "fog1")
    }
    world = World(signed=True, seal=seals.get, carries_sensors=True).start(1000)
    now_s += 2 * 86_400
    world.pass_time(11_000)
    return Ended(world, seals["gs-g"])


def test_who_has_expired_keeps_its_drones_and_gets_no_free_one(ended: Ended) -> None:
    world = ended.world
    assert world.activator.leases.add(2, world.now_ms) == set()
    world.pass_time(40_000)
    assert [world.activator.leases.controls(GS_SESSION, drone) for drone in (1, 2)] == [True, False]
    assert world.uav.is_controlled(world.now_ms)


def test_who_has_expired_is_told_what_became_of_a_command_that_an_earlier_activator_may_have_sent(ended: Ended) -> None:
    world, command = ended.world, signed_command(ended.seal, deadline_ms=1)
    asked = Addressed(0x99, 1, {1: command}).encode()
    out = world.hears("activator", "fog1/drone1/commands", asked)
    (query,) = [effect for effect in out if isinstance(effect, Publish)]
    assert (query.topic, Envelope.parse(query.payload).payload) == ("drone1/commands", command.payload)


def test_who_has_expired_is_not_denied_what_a_client_without_a_journal_may_have_done(ended: Ended) -> None:
    world = ended.world
    world.uav.desk._remembers = False
    query = signed_command(ended.seal, deadline_ms=1).routed(0)
    assert said(to_drone(world, query)) == [(Word.UNCONFIRMED, "no_journal")]


@pytest.mark.parametrize("topic", ["drone1/sensor_ack", "fog1/drone1/sensor_ack"])
def test_who_has_expired_empties_no_store(ended: Ended, topic: str) -> None:
    assert ended.world.uav.carrier is not None
    ended.world.run("uav", ended.world.uav.carrier.on_loaded([(1, reading(1))], 1, ended.world.now_ms))
    ack = ReadingAck(readings=(reading(1).key,))
    assert ended.hear(topic, "drone1/sensor_ack", ack) == (["certificate"], [])


@pytest.mark.parametrize("topic", ["drone1/bulk", "fog1/drone1/bulk"])
@pytest.mark.parametrize("ask", [Get(0, 0), Put(hash_of(b"x"), 1, 0, b"x")])
def test_who_has_expired_stages_and_fetches_nothing(ended: Ended, topic: str, ask: Get | Put) -> None:
    message = BulkAsk(gs_session=GS_SESSION, kind="plan", nonce=1, ask=ask)
    assert ended.hear(topic, "drone1/bulk", message) == (["certificate"], [])


def test_who_has_expired_is_offered_no_drone(ended: Ended) -> None:
    topic = "fog1/commands/goto"
    _, out = ended.hear(topic, topic, chosen(ended.world, SelectMode.OFFER, Goto(47.4, 8.5, 10.0)))
    (answer,) = [
        decode(FogResultMessage, Envelope.parse(one.payload).payload) for one in out if isinstance(one, Publish)
    ]
    assert (answer.seq, answer.denied) == (50, "certificate_expired")


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
    assert kinds(world.hears("activator", "drone1/commands_result/arm", payload))[0] in ("forged", "unknown_signer")


def test_a_broker_that_says_that_nobody_subscribes_is_not_believed(world: World) -> None:
    world.drop = {"commands"}
    sent = world.gs.commands.send(world.gs.fog(1), 1, Arm(), world.now_ms)
    world.drop = set()
    (publish,) = sent[1]
    assert isinstance(publish, Publish)
    out = world.hears("activator", publish.topic, publish.payload)
    (forwarded,) = [e for e in out if isinstance(e, Publish) and e.topic == "drone1/commands"]
    assert list(world.activator.on_published("fog", forwarded.ref, 0x10, world.now_ms)) == []


@pytest.mark.parametrize("route", [None, [1], [1, 2], ["x", True], [-1, False], [2**16, False], 7])
def test_what_a_relay_says_beside_a_word_is_read_strictly(world: World, route: Any) -> None:
    world.drop = {"commands"}
    world.send(Arm())
    payload = Envelope.parse(word("drone1", Word.DENIED, "drone1/commands_result/arm")).routed(route).encode()
    assert kinds(hear(world, payload)) == ["malformed"]
