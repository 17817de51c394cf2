"""States that are signed (docs/protocol.md, R12.20): of the session and the time in which they were said alone."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.core.channel import LATE_MS, SPAN_MS, Channel
from mqttxt.core.clock import Beacon, RemoteClock
from mqttxt.core.effects import Inbound, Log, Publish
from mqttxt.core.settings import Settings
from mqttxt.core.transport import Transport
from mqttxt.errors import ConfigurationError, PayloadError
from mqttxt.security.cose import Envelope
from mqttxt.security.seal import Seal
from mqttxt.station.ground_station import GroundStation
from tests.simulation.signing import seal
from tests.simulation.world import World, heartbeat, position

SESSION = 0xD5


def strict(name: str, fleet: str = "acme") -> Seal:
    """What a node signs with that signs states too."""
    found = seal(name, fleet=fleet)
    found.signs_states = True
    return found


@pytest.fixture
def world() -> World:
    return World(signed=True, seal=strict).start(2000)


def states(world: World, topic: str = "drone1/state/location") -> list[Publish]:
    return [publish for _, publish in world.sent if publish.topic == topic]


def test_states_are_signed_on_both_sides_and_heard(world: World) -> None:
    world.autopilot(heartbeat(armed=True), position(10.0))
    world.pass_time(2000)
    assert world.gs.fogs[1].drones[1].states["location"].message.state.altitude_m == 10.0  # type: ignore[union-attr]
    for topic in ("drone1/state/location", "fog1/drone1/state/location"):
        assert Envelope.parse(states(world, topic)[-1].payload).certificate is None


@pytest.mark.parametrize(("length", "price"), [(1, 79), (23, 79), (24, 80), (255, 80), (256, 81), (60_000, 81)])
def test_a_signature_costs_80_bytes(length: int, price: int) -> None:
    """What docs/protocol.md says of the price."""
    channel = Channel("fog", "", Settings(), strict("drone1"))
    assert len(channel.state_payload("drone1/states", b"\0" * length, SESSION, 5)) - length == price


def test_bundles_are_signed_too() -> None:
    world = World(signed=True, seal=strict, bundles=True).start(3000)
    for topic in ("drone1/states", "fog1/states"):
        assert Envelope.parse(states(world, topic)[-1].payload).payload
    assert "location" in world.gs.fogs[1].drones[1].states
    forged = Envelope.parse(states(world, "fog1/states")[-1].payload).payload
    assert [type(out) for out in world.hears("gs", "fog1/states", forged)] == [Log]


@pytest.mark.parametrize("what", ["unsigned", "changed", "another drone's", "another fleet's", "on another topic"])
def test_what_is_not_the_drones_own_is_dropped(world: World, what: str) -> None:
    genuine = Envelope.parse(states(world)[-1].payload)
    forged = {
        "unsigned": genuine.payload,
        "changed": Envelope(genuine.payload + b"\0", genuine.kid, genuine.signature).encode(),
        "another drone's": Channel("fog", "", Settings(), strict("drone2")).state_payload(
            "drone1/state/location", genuine.payload, world.uav.session, world.now_ms
        ),
        "another fleet's": Channel("fog", "", Settings(), strict("drone1", "other")).state_payload(
            "drone1/state/location", genuine.payload, world.uav.session, world.now_ms
        ),
        "on another topic": states(world, "drone1/state/armed")[-1].payload,
    }[what]
    out: list[Any] = world.hears("activator", "drone1/state/location", forged)
    assert [type(effect) for effect in out] == [Log]
    assert [type(effect) for effect in world.hears("gs", "fog1/drone1/state/location", forged)] == [Log]


def opened(said_ms: int, heard_ms: int, session: int = SESSION) -> bytes:
    """A state that was said at `said_ms` of the drone's clock, which the receiver knows, and heard at `heard_ms`."""
    drone, receiver = (Channel("fog", "", Settings(), strict(name)) for name in ("drone1", "fog1"))
    receiver_seal = receiver.seal
    assert receiver_seal is not None
    assert drone.seal is not None
    receiver_seal.open("t", drone.seal.sign("t", b"", with_certificate=True).encode(), "drone1")
    clock = RemoteClock(SESSION)
    clock.observe(Beacon(SESSION, heard_ms, nonce=1, held_ms=0), heard_ms, heard_ms - 100)
    payload = drone.state_payload("drone1/state/armed", b"\x82\x01\xf5", session, said_ms)
    return receiver.opened_state(Inbound("drone1/state/armed", payload), "drone1", clock, heard_ms)


@pytest.mark.parametrize(
    ("said_ms", "heard_ms"),
    [(5000, 5000), (SPAN_MS - 1, SPAN_MS + 50), (SPAN_MS + 50, SPAN_MS), (SPAN_MS - 1, SPAN_MS + LATE_MS - 2000)],
)
def test_a_state_is_heard_within_its_span_and_a_little_around_it(said_ms: int, heard_ms: int) -> None:
    assert opened(said_ms, heard_ms) == b"\x82\x01\xf5"


@pytest.mark.parametrize(
    ("said_ms", "heard_ms", "session"),
    [
        (5000, 5000 + 2 * SPAN_MS, SESSION),  # its stamp would say that it is new
        (SPAN_MS - 1, SPAN_MS + LATE_MS + 2000, SESSION),
        (5000, 5000, SESSION + 1),
        (5000 + 2 * SPAN_MS, 5000, SESSION),
    ],
)
def test_a_state_of_long_ago_or_of_another_session_is_not(said_ms: int, heard_ms: int, session: int) -> None:
    with pytest.raises(PayloadError, match="expected one of drone1 for this topic"):
        opened(said_ms, heard_ms, session)


def test_before_a_beacon_no_state_is_heard() -> None:
    receiver = Channel("fog", "", Settings(), strict("fog1"))
    for clock in (None, RemoteClock(SESSION)):
        with pytest.raises(PayloadError, match="expected a beacon before"):
            receiver.opened_state(Inbound("drone1/state/armed", b""), "drone1", clock, 0)


def test_states_are_signed_only_beside_all_else() -> None:
    with pytest.raises(ConfigurationError, match="`signed_states`: expected `signed` beside it"):
        Transport().seal(False, True)
    with pytest.raises(ConfigurationError, match="`signed_states`: expected `signed` beside it"):
        GroundStation("mqtt://127.0.0.1", signed_states=True)
