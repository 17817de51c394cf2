"""States on request: off unless the UAV client is set to them; texts, put together and bounded (R3.11, R3.12)."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.effects import Inbound, Publish
from mqttxt.core.settings import Settings
from mqttxt.drone.enquiries import Enquiries
from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.drone.options import UavOptions
from mqttxt.drone.role import UavClient
from mqttxt.drone.texts import MOST_WAITING, Texts
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Stream
from mqttxt.protocol.messages import Word
from mqttxt.protocol.policies import ON_REQUEST, Throttle
from mqttxt.protocol.state_payload import decode_state
from mqttxt.protocol.states import Airframe, AutopilotText, Gps, GpsFix, Power, Severity, State, VelocityNed
from tests.simulation.world import (
    UAV_SESSION,
    command_payload,
    from_autopilot,
    heartbeat,
    on_disk,
    position,
    ready,
    results,
)

INFO, CRITICAL = mavlink.MAV_SEVERITY_INFO, mavlink.MAV_SEVERITY_CRITICAL


def client(all_states: bool, bundles: bool = False) -> UavClient:
    made = UavClient(1, UAV_SESSION, Settings(bundles=bundles), options=UavOptions(all_states=all_states))
    ready(made, 1000)
    return made


def text(said: str, severity: int = INFO, number: int = 0, part: int = 0) -> Any:
    return from_autopilot(mavlink.MAVLink_statustext_message(severity, said.encode(), number, part))


def published(client: UavClient, until_ms: int, since_ms: int = 1000) -> list[tuple[int, str]]:
    """The states that leave on topics of their own, with their times; heartbeats and positions go on meanwhile."""
    out: list[tuple[int, str]] = []
    for now_ms in range(since_ms, until_ms, 100):
        if now_ms % 1000 == 0:
            client.on_mavlink(heartbeat(), now_ms)
            client.on_mavlink(position(), now_ms)
        effects = [effect for effect in client.tick(now_ms) if isinstance(effect, Publish)]
        out += [(now_ms, effect.topic.rsplit("/", 1)[1]) for effect in effects if "/state/" in effect.topic]
    return out


def test_nothing_on_request_leaves_unasked() -> None:
    uav = client(all_states=False)
    uav.on_mavlink(text("Ready"), 1000)
    names = {name for _, name in published(uav, 62_000)}
    assert names
    assert not names & ON_REQUEST


def test_velocity_says_every_three_seconds_that_the_drone_is_heard() -> None:
    times = [at_ms for at_ms, name in published(client(all_states=True), 20_000) if name == "velocity"]
    assert times[0] == 1000
    assert {later - earlier for earlier, later in pairwise(times)} == {3000}


def test_a_stream_of_one_leaves_without_the_others() -> None:
    uav = client(all_states=False)
    command = command_payload(Stream("velocity", 1.0))
    on_disk(uav, uav.on_message("fog", Inbound("drone1/commands", encode(command)), 1000), 1000)
    out: list[Any] = []
    for now_ms in range(1000, 10_000, 500):
        out += uav.on_mavlink(heartbeat(), now_ms)
        out += uav.on_mavlink(position(), now_ms)
        out += uav.on_mavlink(from_autopilot(mavlink.MAVLink_command_ack_message(511, 0, 0, 0, 1, 191)), now_ms)
        out += uav.tick(now_ms)
    topics = [effect.topic for effect in out if isinstance(effect, Publish)]
    assert topics.count("drone1/state/velocity") >= 8
    assert not [topic for topic in topics if topic.rsplit("/", 1)[1] in ON_REQUEST - {"velocity"}]


def test_a_text_has_no_rate() -> None:
    uav = client(all_states=True)
    command = command_payload(Stream("text", 1.0))
    effects = on_disk(uav, uav.on_message("fog", Inbound("drone1/commands", encode(command)), 1000), 1000)
    assert [(result.word, result.reason) for result in results(effects)] == [(Word.DENIED, "unknown_state")]


@pytest.mark.parametrize("bundles", [False, True])
def test_a_text_leaves_on_its_own_topic_bundled_or_not(bundles: bool) -> None:
    uav = client(all_states=True, bundles=bundles)
    uav.on_mavlink(text("Takeoff detected", CRITICAL), 1000)
    told = [effect for effect in uav.tick(1000) if isinstance(effect, Publish) and effect.topic == "drone1/state/text"]
    assert [decode_state("text", effect.payload, relayed=False).state for effect in told] == [
        AutopilotText(Severity.CRITICAL, "Takeoff detected")
    ]
    assert not [name for _, name in published(uav, 61_000, 1100) if name == "text"], "an event is told once"


@pytest.mark.parametrize(
    ("first", "within", "beyond"),
    [
        (VelocityNed(0, 0, 0), VelocityNed(0.5, -0.5, 0.5), VelocityNed(0, 0, -0.6)),
        (Gps(GpsFix.FIX_3D, 12, 0.8), Gps(GpsFix.FIX_3D, 14, 1.3), Gps(GpsFix.FIX_3D, 15, 0.8)),
        (Gps(GpsFix.FIX_3D, 12, 0.8), Gps(GpsFix.FIX_3D, 11, 0.8), Gps(GpsFix.RTK_FIXED, 12, 0.8)),
        (Gps(GpsFix.FIX_3D, 12, 0.8), Gps(GpsFix.FIX_3D, 12, 0.9), Gps(GpsFix.FIX_3D, 12)),
        (Power(15.8, 2.0), Power(15.7, 7.0), Power(15.5, 2.0)),
        (Power(15.8, 2.0), Power(15.8, 6.0), Power(15.8)),
    ],
)
def test_their_deadbands(first: State, within: State, beyond: State) -> None:
    throttle = Throttle()
    throttle.update(first)
    assert throttle.due(0) == [first]
    throttle.update(within)
    assert throttle.due(2900) == []
    throttle.update(beyond)
    assert throttle.due(5000) == [beyond]


def test_a_version_is_asked_for_until_it_comes_and_outlives_a_heartbeat() -> None:
    vehicle = Vehicle(1)
    enquiries = Enquiries(vehicle, all_states=True)
    asked = []
    for now_ms in range(0, 4000, 500):
        vehicle.update(heartbeat(), now_ms)
        asked += [message for message in enquiries.due(now_ms) if _is_for_version(message)]
    assert len(asked) > 1
    message = mavlink.MAVLink_autopilot_version_message(0, 0x010F00FF, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)
    vehicle.update(from_autopilot(message), 4000)
    vehicle.update(heartbeat(), 4500)
    assert vehicle.seen(Airframe) == Airframe(12, 2, 0x010F00FF)
    assert not [message for now_ms in range(5000, 60_000, 500) for message in _due(enquiries, vehicle, now_ms)]


def test_parts_are_put_together_also_where_the_last_one_is_missing() -> None:
    texts = Texts()
    whole = "Preflight Fail: " + "x" * 60
    texts.on_message(text(whole[:50], CRITICAL, 7, 0), 0)
    texts.on_message(text(whole[50:], CRITICAL, 7, 1), 10)
    texts.on_message(text("y" * 50, INFO, 8, 0), 20)
    assert texts.due(30) == [AutopilotText(Severity.CRITICAL, whole)]
    assert texts.due(900) == []
    assert texts.due(1020) == [AutopilotText(Severity.INFO, "y" * 50)]


def test_a_text_that_is_said_again_and_again_is_told_every_ten_seconds() -> None:
    texts, told = Texts(), 0
    for now_ms in range(0, 30_000, 100):
        texts.on_message(text("GPS lost", CRITICAL), now_ms)
        told += len(texts.due(now_ms))
    assert told == 3


def test_of_a_flood_the_severe_ones_are_kept_and_leave_five_a_second() -> None:
    texts = Texts()
    texts.on_message(text("motor 3", CRITICAL), 0)
    for number in range(3 * MOST_WAITING):
        texts.on_message(text(f"info {number}"), 0)
    told = [(now_ms, said) for now_ms in range(0, 10_000, 100) for said in texts.due(now_ms)]
    assert len(told) == MOST_WAITING
    assert told[0] == (0, AutopilotText(Severity.CRITICAL, "motor 3"))
    assert all(later - earlier >= 200 for (earlier, _), (later, _) in pairwise(told))


def test_a_severity_that_is_none_and_an_empty_text_are_not_told() -> None:
    texts = Texts()
    texts.on_message(text("?", severity=9), 0)
    texts.on_message(text("\t"), 0)
    assert texts.due(5000) == []


def _is_for_version(message: Any) -> bool:
    return bool(getattr(message, "param1", 0) == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION and message.command == 512)


def _due(enquiries: Enquiries, vehicle: Vehicle, now_ms: int) -> list[Any]:
    vehicle.heartbeat_ms = now_ms
    return [message for message in enquiries.due(now_ms) if _is_for_version(message)]
