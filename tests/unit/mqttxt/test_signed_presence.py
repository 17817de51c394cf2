"""Signed presence (docs/protocol.md, section 12): births, beacons, choices, and whatever comes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import cbor2
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from mqttxt.activator.drone_link import DroneLink
from mqttxt.activator.role import Activator
from mqttxt.activator.selector import Reservation
from mqttxt.cli.uav import _own_fog
from mqttxt.core.effects import Inbound, Log, Publish, Stop
from mqttxt.core.settings import Settings
from mqttxt.core.transport import Transport
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Goto, Hold, Offboard, Velocity
from mqttxt.protocol.messages import BeaconMessage, FogPresence, Presence, Word
from mqttxt.protocol.rankings import PsmiMessage, SelectMode
from mqttxt.protocol.values import Encoding
from mqttxt.security.addressed import Addressed
from mqttxt.security.cose import Envelope
from mqttxt.station.ground_station import GroundStation
from tests.examples import examples
from tests.simulation.signed import chosen, kinds, last_sent, outcomes, said, to_drone
from tests.simulation.signing import seal
from tests.simulation.world import (
    FOG_SESSION,
    GS_SESSION,
    UAV_SESSION,
    World,
    command_payload,
    heartbeat,
    landed,
    position,
)

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
        assert kinds(world.hears("gs", "fog1/drone1/clock", payload))
        assert kinds(world.hears("activator", "drone1/clock", payload))
    assert clock.deadline_ms(world.now_ms, 0) == before


def test_an_old_echo_does_not_refuse_a_newcomer(world: World) -> None:
    echo = next(publish for _, publish in world.sent if publish.topic == "drone1/clock")
    birth = seal("drone1").sign("drone1/reachable", encode(Presence(session=0x44, up=True)), with_certificate=True)
    world.hears("activator", "drone1/reachable", birth.encode())
    out = world.hears("activator", "drone1/clock", echo.payload)
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
    rival.ownership.born = True
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
    out = world.hears("activator", topic, padded.encode())
    assert [type(effect) for effect in out] == [Log]


def test_a_beacon_that_is_repeated_shows_nobody_as_reachable(world: World) -> None:
    beacon, of_fog = last_sent(world, "drone1/clock"), last_sent(world, "fog1/clock")
    world.drop = {"clock"}
    for _ in range(4):
        world.pass_time(10_000)
        world.hears("activator", "drone1/clock", beacon.payload)
        world.hears("gs", "fog1/clock", of_fog.payload)
    assert not world.activator.drones.links[1].announced
    assert not world.gs.fogs[1].is_live(world.now_ms)


def test_an_own_record_that_was_rolled_back_is_put_right(world: World) -> None:
    """It is signed, and of this session: but another station had control then."""
    topic = "fog1/drone1/reachable"
    records = [publish for _, publish in world.sent if publish.topic == topic]
    newest = world.retained["cloud", topic].payload
    older = next(publish for publish in records if decode_signed(publish.payload) != decode_signed(newest))
    world.route("broker", older)
    world.pass_time(1500)
    assert decode_signed(world.retained["cloud", topic].payload) == decode_signed(newest)


def test_an_own_birth_that_was_rolled_back_is_put_right(world: World) -> None:
    """It is signed, and of this session: but another drone session was in its roster then."""
    topic = "fog1/reachable"
    newest = world.retained["cloud", topic].payload
    older = next(one for _, one in world.sent if one.topic == topic and one.payload != newest)
    world.route("broker", older)
    world.pass_time(1500)
    assert world.retained["cloud", topic].payload == newest


def test_an_own_birth_that_the_next_one_replaces_is_not_repeated(world: World) -> None:
    births = [one for _, one in world.sent if one.topic == "fog1/reachable"]
    world.pass_time(5000)
    assert [one for _, one in world.sent if one.topic == "fog1/reachable"] == births


def test_an_own_record_that_the_next_one_replaces_is_not_repeated(world: World) -> None:
    count = len(world.sent)
    world.run("gs", world.gs.take_over(1, None, world.now_ms))
    world.pass_time(3000)
    records = [publish for _, publish in world.sent[count:] if publish.topic == "fog1/drone1/reachable"]
    assert len(records) == len({decode_signed(publish.payload) for publish in records})


# Payloads in JSON.


def test_what_is_signed_may_be_json() -> None:
    world = World(signed=True, encoding=Encoding.JSON).start(1000)
    for command, drone in ((Arm(), 1), (Hold(), None)):
        world.heard.clear()
        world.wrote.clear()
        world.send(command, drone)
        assert len(world.wrote) == 1
    world.autopilot(heartbeat(armed=True), landed(2), position(10.0))
    world.send(Offboard(60.0, velocity=Velocity(1.0, 0.0, 0.0)))
    world.pass_time(3000)
    assert world.uav.desk.executor.lease.offboard_until_ms is not None
    signed = [Envelope.parse(publish.payload) for _, publish in world.sent if publish.topic == "drone1/commands"]
    assert [envelope.payload[:1] for envelope in signed] == [b"{"] * 3
    changed = signed[0].payload.replace(b'"arm"', b'"land"')
    out = to_drone(world, replace(signed[0], payload=changed))
    assert (said(out), kinds(out)) == ([], ["forged"])
    assert not [log for log in world.logs if log.kind not in ("unknown_signer", "unknown_session")]
    world.restart_activator(0x99)
    world.pass_time(6000)
    world.heard.clear()
    world.send(Hold())
    assert [envelope.payload for envelope in signed] != []
    assert world.gs.fogs[1].controls(1)


def test_a_malformed_json_command_of_a_station_is_answered(world: World) -> None:
    payload = (
        b'{"version":1,"gs_session":17,"seq":9,"executor_session":51,"deadline_ms":5000,"limit_s":1,"command":"x"}'
    )
    payload = payload.replace(b"17", str(GS_SESSION).encode(), 1)
    assert [word for word, _ in said(to_drone(world, seal("gs-g").sign("drone1/commands", payload)))] == [Word.DENIED]


# A choice of a drone.

TARGET = Goto(47.3978, 8.5456, 12.0)


def test_no_fog_chooses_by_itself(world: World) -> None:
    with pytest.raises(ConfigurationError, match="an offer and a commit"):
        world.gs.commands.select(world.gs.fog(1), TARGET, world.now_ms)
    select = world.gs.commands._channel.payload  # as a station of another make would sign it
    payload = select("fog1/commands/goto", chosen(world, SelectMode.SELECT, TARGET))
    assert kinds(world.hears("activator", "fog1/commands/goto", payload)) == ["not_signed"]


def test_a_commit_is_signed_for_the_drone_that_was_offered(world: World) -> None:
    held = world.activator.selector
    offer, outputs = world.gs.commands.select(
        world.gs.fog(1), TARGET, world.now_ms, mode=SelectMode.OFFER, limit_s=30.0
    )
    world.run("gs", outputs)
    answer = decode(PsmiMessage, decode_signed(last_sent(world, "fog1/PSMI").payload))
    assert answer.id == offer
    held._reservations[offer] = Reservation(1, TARGET, world.now_ms + 30_000)
    _, outputs = world.gs.commands.select(
        world.gs.fog(1), TARGET, world.now_ms, mode=SelectMode.COMMIT, reservation=offer.seq, drone=1
    )
    world.run("gs", outputs)
    forwarded = Envelope.parse(last_sent(world, "drone1/commands").payload)
    assert forwarded.signature == Addressed.parse(last_sent(world, "fog1/commands/goto").payload).entries[1].signature


def test_a_commit_of_an_earlier_session_is_asked_of_the_drone_alone_that_it_is_signed_for(world: World) -> None:
    """That nothing is signed for the others is no word of the one that may be flying."""
    role = world.activator
    role.drones.were_shown = True
    role.drones.links[2] = DroneLink(2)
    signed = seal("gs-g").sign("drone2/commands", encode(command_payload(TARGET, seq=50)))
    commit = Addressed(0x99, world.now_ms + 5000, {2: signed}, reservation=49).encode()
    out = role.on_message("cloud", Inbound("fog1/commands/goto", commit, 1), world.now_ms)
    assert [effect for effect in out if isinstance(effect, Publish)] == []
    (entry,) = role.relay.ledger.open_entries()
    assert list(entry.record.legs) == [2]


# What is set where the node is.


def test_signing_takes_an_identity_and_a_drone_its_fog() -> None:
    with pytest.raises(ConfigurationError, match="`signed`: expected `identity` beside it"):
        Transport().seal(True)
    with pytest.raises(ConfigurationError, match="`signed`: expected `identity` beside it"):
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


@examples(150, suppress_health_check=list(HealthCheck))
@given(role=st.sampled_from(sorted(TOPICS)), payload=PLAIN | ENVELOPES | ADDRESSED, data=st.data())
def test_nobody_fails_by_what_is_not_signed(role: str, payload: Any, data: st.DataObject) -> None:
    world = _running()
    topic = data.draw(st.sampled_from(TOPICS[role]))
    link = "fog" if topic.startswith("drone") else "cloud"
    out = getattr(world, role).on_message(link, Inbound(topic, cbor2.dumps(payload), 1), world.now_ms)
    assert not [effect for effect in out if isinstance(effect, Publish) and not effect.topic.endswith("/reachable")]


@cache
def _running() -> World:
    return World(signed=True).start(1000)
