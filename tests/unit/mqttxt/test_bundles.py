"""Bundles: a drone's states in one message, a fog's in one, and each station gets the form that it asked for (10)."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.channel import Channel
from mqttxt.core.effects import Log, Publish
from mqttxt.core.settings import Settings
from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.drone.published_states import PublishedStates
from mqttxt.drone.role import UavClient
from mqttxt.drone.streams import Streams
from mqttxt.protocol.bundles import MAX_DRONES, DroneBundle, FogBundle, drone_bundle, fog_bundles, states_of
from mqttxt.protocol.cbor import MAX_PAYLOAD
from mqttxt.protocol.codec import decode, encode, layout_of
from mqttxt.protocol.control import Control
from mqttxt.protocol.fields import Binary, Integer, Scaled
from mqttxt.protocol.rankings import Candidate, PsmiMessage, QodsMessage, Ranked
from mqttxt.protocol.state_payload import StampedState, decode_state
from mqttxt.protocol.states import STATE, Armed, AutopilotText, Battery, Groundspeed, Heading, Severity
from mqttxt.protocol.topics import FogSide
from mqttxt.protocol.values import Encoding
from tests.simulation.fogs import ActivatorBench, of, ready
from tests.simulation.world import UAV_SESSION, from_autopilot, heartbeat, position
from tests.simulation.world import ready as start


@pytest.fixture
def bench() -> ActivatorBench:
    """An activator whose one station takes bundles and controls nothing."""
    made = ready(controlled=False)
    made.register(bundles=True, control=Control.NONE)
    return made


def bundles(effects: list[Any]) -> list[list[tuple[int, str]]]:
    found = [states_of(decode(FogBundle, publish.payload)) for publish in of(effects, "fog1/states")]
    return [[(drone, stamped.state.name) for drone, stamped in pairs] for pairs in found]


def heard(effects: list[Any]) -> list[Any]:
    """The states of all bundles of a fog, in their order."""
    found = [states_of(decode(FogBundle, publish.payload)) for publish in of(effects, "fog1/states")]
    return [stamped.state for pairs in found for _, stamped in pairs]


def topics(effects: list[Any]) -> list[str]:
    return [e.topic for e in effects if isinstance(e, Publish) and "/state/" in e.topic]


def bundled(bench: ActivatorBench, *states: Any) -> list[Any]:
    own_ms = bench.now_ms + 90_000
    return bench.fog("drone1/states", drone_bundle(states, own_ms // 10 % 65536))


def test_a_uav_client_with_bundles_publishes_what_is_due_together_once_a_second() -> None:
    client = UavClient(1, UAV_SESSION, Settings(bundles=True))
    start(client)
    out = [e for e in client.tick(100) if isinstance(e, Publish) and e.topic == "drone1/states"]
    (bundle,) = [decode(DroneBundle, publish.payload) for publish in out]
    assert {one.state.name for one in bundle.states} >= {"location", "heading", "armed", "home", "landed_state"}
    client.on_mavlink(position(5), 400)
    assert not [e for e in client.tick(600) if isinstance(e, Publish)]
    (later,) = [e for e in client.tick(1100) if isinstance(e, Publish)]
    assert [one.state.name for one in decode(DroneBundle, later.payload).states] == ["location"]


def test_an_urgent_state_does_not_wait_for_the_second() -> None:
    client = UavClient(1, UAV_SESSION, Settings(bundles=True))
    start(client)
    client.tick(100)
    client.on_mavlink(heartbeat(armed=True), 300)
    (publish,) = [e for e in client.tick(300) if isinstance(e, Publish)]
    assert [one.state for one in decode(DroneBundle, publish.payload).states] == [Armed(True)]


@pytest.mark.parametrize("early", [False, True])
def test_a_value_that_cannot_be_carried_is_counted_and_keeps_nothing_else_back(early: bool) -> None:
    channel = Channel("fog", "", Settings(bundles=True))
    vehicle = Vehicle(1)
    vehicle.update(position(), 0)
    vehicle.update(from_autopilot(mavlink.MAVLink_vfr_hud_message(0, 0, 90, 0, 0, 0)), 0)
    vehicle.update(from_autopilot(mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [0] * 10, 0, 0, 0, 50)), 0)
    states = PublishedStates(1, UAV_SESSION, channel, FogSide(), Streams(vehicle), vehicle, None)
    for state in (Battery(50), Groundspeed(1e9), Heading(90)):
        states.throttle.update(state)
    publish, log = states.bundle(100, early=early)
    assert isinstance(publish, Publish)
    assert isinstance(log, Log)
    assert [one.state for one in decode(DroneBundle, publish.payload).states] == [Battery(50), Heading(90)]
    assert log.kind == "autopilot_value"
    assert log.detail.startswith("groundspeed")


def test_topics_are_served_from_bundles() -> None:
    effects = bundled(ready(), Battery(50), Heading(90))
    assert topics(effects) == ["fog1/drone1/state/battery", "fog1/drone1/state/heading"]
    relayed = decode_state("battery", effects[0].payload, relayed=True)
    assert relayed.state == Battery(50)
    assert relayed.relay_stamp is not None


def test_bundles_are_served_from_topics_and_states_wait_for_each_other(bench: ActivatorBench) -> None:
    bench.until(bench.now_ms + 100)
    assert topics(bench.tell(Battery(50))) == []
    first = bundles(bench.until(bench.now_ms + 1000))
    assert first == [[(1, "battery")]]
    bench.tell(Battery(49))
    bench.tell(Groundspeed(3))
    assert bundles(bench.until(bench.now_ms + 1000)) == [[(1, "battery"), (1, "groundspeed")]]
    bench.tell(Groundspeed(5))
    bench.tell(Armed(True))
    assert bundles(bench.until(bench.now_ms + 100)) == [[(1, "groundspeed"), (1, "armed")]]
    bench.tell(Armed(True))  # as before: said again, no news
    assert bundles(bench.until(bench.now_ms + 100)) == []
    assert bundles(bench.until(bench.now_ms + 1000)) == [[(1, "armed")]]


def test_a_text_is_in_no_bundle(bench: ActivatorBench) -> None:
    bench.until(bench.now_ms + 100)
    assert topics(bench.tell(AutopilotText(Severity.INFO, "Ready"))) == ["fog1/drone1/state/text"]
    assert bundles(bench.until(bench.now_ms + 1500)) == []


def test_no_value_of_a_state_that_comes_once_a_second_is_overtaken_whatever_the_clocks_drift(
    bench: ActivatorBench,
) -> None:
    told: list[Any] = []
    for value in range(28):
        told += bench.tell(Groundspeed(value))
        told += bench.until(bench.now_ms + 880 + 20 * (value % 3))
    told += bench.until(bench.now_ms + 1500)
    assert [state for state in heard(told) if isinstance(state, Groundspeed)] == [Groundspeed(n) for n in range(28)]
    assert len(of(told, "fog1/states")) <= 30


def test_values_that_a_link_held_up_and_brought_together_are_all_told(bench: ActivatorBench) -> None:
    bench.until(bench.now_ms + 3000)
    told = [effect for age_ms in (2000, 1000, 0) for effect in bench.state(age_ms // 100, bench.now_ms - age_ms)]
    told += bench.until(bench.now_ms + 1500)
    assert [state for state in heard(told) if isinstance(state, Battery)] == [Battery(20), Battery(10), Battery(0)]


def test_a_value_that_left_early_with_something_urgent_overtakes_none(bench: ActivatorBench) -> None:
    told: list[Any] = []
    for pause_ms in (1000, 1000, 150, 1000, 1000):
        told += bench.tell(Groundspeed(bench.now_ms % 60_000 / 1000))
        told += bench.until(bench.now_ms + pause_ms)
    told += bench.until(bench.now_ms + 1500)
    assert len([state for state in heard(told) if isinstance(state, Groundspeed)]) == 5


def test_a_change_that_is_not_to_be_missed_is_told_although_the_next_came_at_once(bench: ActivatorBench) -> None:
    bench.until(bench.now_ms + 1000)
    told = bench.tell(Armed(True))
    bench.now_ms += 20
    told += bench.tell(Armed(False)) + bench.until(bench.now_ms + 1500)
    assert [state for state in heard(told) if isinstance(state, Armed)] == [Armed(True), Armed(False)]


def test_of_a_state_that_comes_faster_than_bundles_leave_the_newest_counts(bench: ActivatorBench) -> None:
    bench.until(bench.now_ms + 1000)
    told: list[Any] = []
    for value in range(50):
        told += bench.tell(Groundspeed(value))
        told += bench.until(bench.now_ms + 200)
    assert 9 <= len(of(told, "fog1/states")) <= 11


def test_a_station_for_each_form_gets_each_form() -> None:
    bench = ready()
    bench.register(name="beta", session=9, bundles=True)
    assert topics(bench.tell(Battery(50))) == ["fog1/drone1/state/battery"]
    assert bundles(bench.until(bench.now_ms + 1000)) == [[(1, "battery")]]


def test_without_a_station_nothing_is_bundled_for_later() -> None:
    bench = ready()
    bench.register(bundles=True)
    bench.tell(Battery(50))
    bench.register(bundles=True, lease_s=0)
    bench.until(bench.now_ms + 2000)
    bench.register(name="beta", session=9, bundles=True)
    assert bundles(bench.until(bench.now_ms + 1000)) == [[(1, "battery")]]  # told because it registered, once


def test_a_large_fog_is_told_in_several_messages() -> None:
    pairs = [(1 + n % 250, StampedState(Battery(50), n, n)) for n in range(MAX_DRONES + 1)]
    made = fog_bundles(pairs)
    assert [len(bundle.drones) for bundle in made] == [MAX_DRONES, 1]
    assert [pair for bundle in made for pair in states_of(bundle)] == pairs


def test_four_states_of_three_drones_are_less_than_a_mavlink_message_each() -> None:
    states = (Battery(80), Heading(90.0), Groundspeed(5.0), Armed(True))
    pairs = [(drone, StampedState(state, 100, 90)) for drone in (1, 2, 3) for state in states]
    (bundle,) = fog_bundles(pairs)
    assert len(encode(bundle)) < 3 * 40


@pytest.mark.parametrize("encoding", Encoding)
def test_a_full_bundle_and_the_rankings_of_a_full_fog_fit_into_a_payload(encoding: Encoding) -> None:
    """All states of as many drones as a bundle takes; 250 drones left out, each with its figures and a long reason."""
    states = [cls(**{f.name: _widest(f.mark) for f in layout_of(cls).fields}) for cls in STATE.by_code.values()]
    pairs = [(200 + n, StampedState(state, 60_000, 60_000)) for n in range(MAX_DRONES) for state in states]
    (bundle,) = fog_bundles(pairs)
    figures = {"distance_m": 12_345.6, "arrival_s": 1234.5, "max_groundspeed_m_s": 12.34, "remaining_pct": 88}
    reason = "not_in_control, " + "x" * 64
    left_out = tuple(
        Candidate(drone=n, reason=reason, range_m=12_345.6, age_s=12.3, **figures)  # type: ignore[arg-type]
        for n in range(1, 251)
    )
    psmi = PsmiMessage(gs_session=2**32 - 1, seq=1, session=2**32 - 1, stamp=1, listed=(), left_out=left_out)
    ranked = tuple(Ranked(drone=n, remaining_pct=88, max_groundspeed_m_s=12.34, age_s=12.3) for n in range(1, 251))
    qods = QodsMessage(session=2**32 - 1, stamp=1, ranking=ranked)
    for message in (bundle, psmi, qods):
        payload = encode(message, encoding)
        assert len(payload) <= MAX_PAYLOAD
        assert decode(type(message), payload) == message


def _widest(mark: Any) -> Any:
    """The value that takes the most bytes."""
    if isinstance(mark, Integer | Scaled):
        return mark.high
    if isinstance(mark, Binary):
        return bytes(mark.most)
    return True if mark is bool else list(mark)[-1]
