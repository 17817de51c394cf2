"""Signed commands (docs/protocol.md, section 12): from station to drone, changed, moved and forged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from mqttxt.core.effects import Log, Publish
from mqttxt.drone.effects import Journal
from mqttxt.errors import FogUnreachable
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Hold
from mqttxt.protocol.control import DroneRecord
from mqttxt.protocol.messages import BeaconMessage, CommandId, FogPresence, FogResultMessage, RosterEntry, Word
from mqttxt.security.addressed import Addressed
from mqttxt.security.cose import Envelope
from mqttxt.station.outcomes import Outcome
from tests.simulation.signed import (
    OTHER_SESSION,
    hear,
    kinds,
    last_sent,
    outcomes,
    said,
    signed_command,
    to_drone,
    word,
)
from tests.simulation.signing import seal
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION, World, ack, command_payload, heartbeat

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
    fog, moved = world.gs.fog(2), last_sent(world, "fog1/drone1/clock").payload
    assert kinds(world.hears("gs", "fog2/drone1/clock", moved)) == ["forged"]
    record = DroneRecord(activator_session=5, up=True, drone_session=UAV_SESSION)  # the thief of fog 2's key says so
    fog.on_record(1, record, world.now_ms)
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
    out = world.hears("gs", results_of_fog[-1].topic, results_of_fog[-1].payload)
    assert [(o.drone, o.word, o.reason, o.signer) for o in out if isinstance(o, Outcome)] == [
        (None, Word.DENIED, "id_conflict", "fog1")
    ]
    assert not world.gs.commands.pending[sent].is_open
    for said_word in (Word.ACCEPTED, Word.COMPLETED):
        out = hear(world, word("drone1", said_word, "drone1/commands_result/arm", seq=sent.seq))
        assert kinds(out) == ["contradicted"]
    assert [(o.drone, o.word, o.settled) for o in world.heard if isinstance(o, Outcome)] == [(1, Word.COMPLETED, True)]


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
    world.uav.desk.executor.lease.holder_session = GS_SESSION
    envelope = signed_command(deadline_ms=world.now_ms + 3000)
    assert said(to_drone(world, envelope.routed(0))) == [(Word.DENIED, "ledger_full")]
    world.uav.desk.ledger._capacity = 4096
    world.now_ms += 1000
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
    assert any(isinstance(e, Journal) for e in to_drone(world, signed_command()))  # and the true one counts


def test_an_activator_answers_and_enters_nothing_forged(world: World) -> None:
    for what, forged in forgeries().items():
        entries = {1: forged} if isinstance(forged, Envelope) else {}
        payload = Addressed(FOG_SESSION, world.now_ms + 5000, entries).encode()
        out = world.hears("activator", "fog1/drone1/commands", payload)
        assert [effect for effect in out if not isinstance(effect, Log)] == [], what
        assert world.activator.relay.ledger.get(CommandId(GS_SESSION, 9)) is None


def test_a_malformed_command_of_a_station_is_answered(world: World) -> None:
    row = b"\x87\x01\x18\x11\x09\x18\x33\x19\x13\x88\x18\x64\x00"
    assert [word for word, _ in said(to_drone(world, seal("gs-g").sign("drone1/commands", row)))] == [Word.DENIED]
    payload = Addressed(FOG_SESSION, 9999, {1: seal("gs-g").sign("drone1/commands", row)}).encode()
    assert [word for word, _ in said(world.hears("activator", "fog1/drone1/commands", payload))] == [Word.DENIED]


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
    out = world.hears("activator", "fog1/drone1/commands", payload)
    assert [type(effect) for effect in out] == [Log]
