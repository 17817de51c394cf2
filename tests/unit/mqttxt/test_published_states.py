"""A state leaves with a new stamp only while its autopilot shows that it is as it was (R3.5)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.effects import Inbound, Publish
from mqttxt.core.settings import Settings
from mqttxt.drone.mavlink.vehicle import LOST_MS
from mqttxt.drone.options import UavOptions
from mqttxt.drone.role import UavClient
from mqttxt.protocol.bundles import DroneBundle
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Stream
from tests.simulation.world import (
    UAV_SESSION,
    ack,
    command_payload,
    connect,
    from_autopilot,
    heartbeat,
    landed,
    on_disk,
    position,
    ready,
)

OWN = {"location", "heading", "landed_state", "flight_mode", "armed"}


def battery(number: int, remaining_pct: int) -> Any:
    return from_autopilot(mavlink.MAVLink_battery_status_message(number, 0, 0, 0, [0] * 10, 0, 0, 0, remaining_pct))


BATTERY, UNKNOWN, SECOND = battery(0, 50), battery(0, -1), battery(1, 90)
TOO_HIGH = from_autopilot(mavlink.MAVLink_global_position_int_message(0, 0, 0, 2**31 - 1, 0, 0, 0, 0, 0))
NO_HEADING = from_autopilot(mavlink.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 2**16 - 1))


def client(bundles: bool = False) -> UavClient:
    made = UavClient(1, UAV_SESSION, Settings(bundles=bundles), options=UavOptions(endurance_s=1200.0))
    ready(made)
    return made


def names(effects: list[Any]) -> list[str]:
    """The published states, each on its topic or in a bundle."""
    out: list[str] = []
    for effect in effects:
        if isinstance(effect, Publish) and "/state/" in effect.topic:
            out.append(effect.topic.rsplit("/", 1)[1])
        elif isinstance(effect, Publish) and effect.topic == "drone1/states":
            out += [one.state.name for one in decode(DroneBundle, effect.payload).states]
    return out


def lived(client: UavClient, since_ms: int, until_ms: int, *each_second: Callable[[], Any]) -> list[str]:
    """The states that leave meanwhile."""
    out: list[Any] = []
    for now_ms in range(since_ms, until_ms, 100):
        if now_ms % 1000 == 0:
            for message in each_second:
                out += client.on_mavlink(message(), now_ms)
        out += client.tick(now_ms)
    return names(out)


def connected_anew(client: UavClient, now_ms: int) -> None:
    client.on_disconnected("fog", now_ms)
    connect(client, now_ms)


@pytest.mark.parametrize("bundles", [False, True])
def test_a_dead_autopilots_states_are_not_repeated_and_leave_again_once_it_is_back(bundles: bool) -> None:
    uav = client(bundles)
    assert OWN | {"home"} <= set(lived(uav, 0, LOST_MS))
    assert lived(uav, LOST_MS + 100, 300_000) == []
    connected_anew(uav, 300_000)
    assert lived(uav, 300_000, 310_000) == []
    assert OWN | {"home"} <= set(lived(uav, 310_000, 312_000, heartbeat, position, lambda: landed(1)))


def test_a_state_whose_own_message_stops_is_not_repeated_and_the_others_are() -> None:
    uav = client()
    uav.on_mavlink(BATTERY, 0)
    lived(uav, 0, 20_000, heartbeat, position)
    found = lived(uav, 20_000, 90_000, heartbeat, position)
    assert {"location", "heading", "armed", "flight_mode", "home"} == set(found)
    assert found.count("home") >= 2


@pytest.mark.parametrize(
    ("state", "message"),
    [("battery", UNKNOWN), ("battery", SECOND), ("location", TOO_HIGH), ("heading", NO_HEADING)],
)
def test_a_state_is_not_repeated_by_messages_without_a_value_of_it(state: str, message: Any) -> None:
    uav = client()
    uav.on_mavlink(BATTERY, 0)
    assert state in lived(uav, 0, LOST_MS, heartbeat, position)
    lived(uav, LOST_MS, 2 * LOST_MS, heartbeat, lambda: message)
    found = lived(uav, 2 * LOST_MS, 100_000, heartbeat, lambda: message)
    assert state not in found
    assert "armed" in found


def test_a_streamed_state_leaves_only_with_a_value_of_it() -> None:
    uav = client()
    command = encode(command_payload(Stream("battery", 1.0)))
    on_disk(uav, uav.on_message("fog", Inbound("drone1/commands", command), 0), 0)
    uav.on_mavlink(ack(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL), 0)
    both = lived(uav, 0, 20_000, heartbeat, lambda: SECOND, lambda: BATTERY)
    assert both.count("battery") >= 19
    assert "battery" not in lived(uav, 20_000, 40_000, heartbeat, lambda: SECOND, lambda: UNKNOWN)


def test_a_state_of_parameters_that_is_streamed_ends_with_the_heartbeats() -> None:
    uav = client()
    speed = mavlink.MAVLink_param_value_message(b"MPC_XY_VEL_MAX", 12.0, mavlink.MAV_PARAM_TYPE_REAL32, 1, 0)
    uav.on_mavlink(from_autopilot(speed), 0)
    command = encode(command_payload(Stream("max_groundspeed", 1.0)))
    on_disk(uav, uav.on_message("fog", Inbound("drone1/commands", command), 0), 0)
    assert lived(uav, 100, 40_000, heartbeat).count("max_groundspeed") >= 39
    assert "max_groundspeed" not in lived(uav, 39_000 + LOST_MS + 100, 100_000)


def test_a_streamed_state_that_waited_for_a_bundle_is_not_known_for_ever() -> None:
    uav = client(bundles=True)
    command = encode(command_payload(Stream("location", 1.0)))
    on_disk(uav, uav.on_message("fog", Inbound("drone1/commands", command), 0), 0)
    lived(uav, 0, 5000, heartbeat, position, lambda: ack(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL))
    uav.on_disconnected("fog", 5000)
    lived(uav, 5000, 8000, heartbeat, position)
    connected_anew(uav, 60_000)
    assert lived(uav, 60_000, 62_000) == []
