"""The messages of the byte figures: five states and five commands, MQTT-XT and MAVLink 2, with values as in flight."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Command, Goto, Land, Offboard, Takeoff, Velocity
from mqttxt.protocol.messages import CommandMessage
from mqttxt.protocol.values import Encoding

STAMP = 4660
COMMANDS: tuple[Command, ...] = (
    Arm(),
    Takeoff(10),
    Land(),
    Offboard(5, velocity=Velocity(2, 0, 0)),
    Goto(47.3980, 8.5460, 15),
)


def command_payload(command: Command, encoding: Encoding) -> bytes:
    """A command of a station that has sent a few, to an executor that has run for twenty minutes."""
    message = CommandMessage(
        gs_session=0x12345678,
        seq=7,
        executor_session=0x9ABCDEF0,
        deadline_ms=1_234_567,
        limit_s=command.limit_s,
        command=command,
    )
    return encode(message, encoding)


def packed(message: Any, system: int = 1) -> bytes:
    """A message as it is sent, with a sequence number as in mid-flight."""
    codec = mavlink.MAVLink(None, system, 1)
    codec.seq = 77
    return bytes(message.pack(codec))


def mavlink_states() -> dict[str, bytes]:
    """The MAVLink messages that carry the five states; location and heading are in the same one."""
    battery, position, hud, heartbeat = (packed(message) for message in telemetry(0))
    return {
        "battery": battery,
        "location": position,
        "heading": position,
        "groundspeed": hud,
        "flight_mode": heartbeat,
    }


def telemetry(second: int) -> tuple[Any, ...]:
    """Battery, position with heading, speed and mode of a flight, second by second."""
    odd = second % 2
    cells = [4012, 4010, 4011, 4009] + [65535] * 6
    north, turn = 473_980_000 + 1100 * second, (12_345 + 700 * second) % 36_000
    return (
        mavlink.MAVLink_battery_status_message(0, 1, 1, 2851, cells, 1423, 612, 2210, 87 - odd, 1240, 1),
        mavlink.MAVLink_global_position_int_message(
            1_234_567 + 1000 * second, north, 85_460_000, 503_200, 15_200, 1180, -35, 12, turn
        ),
        mavlink.MAVLink_vfr_hud_message(11.9, 11.87 + odd, turn // 100, 54, 503.2, -0.12),
        mavlink.MAVLink_heartbeat_message(2, 12, 157, 4 << 16 | 4 << 24, 4, 3),
    )


def mavlink_commands() -> dict[str, bytes]:
    """A MAVLink ground station's messages for the five commands; for offboard the mode, without its set-points."""
    nan = math.nan

    def long(command: int, *params: float) -> bytes:
        given = [*params, *[0.0] * (7 - len(params))]
        return packed(mavlink.MAVLink_command_long_message(1, 1, command, 0, *given), 245)

    goto = mavlink.MAVLink_command_int_message(1, 1, 0, 192, 0, 0, -1, 1, 0, nan, 473_980_000, 85_460_000, 503.2)
    return {
        "arm": long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1),
        "takeoff": long(mavlink.MAV_CMD_NAV_TAKEOFF, nan, nan, nan, nan, nan, nan, 498.0),
        "land": long(mavlink.MAV_CMD_NAV_LAND, *[nan] * 7),
        "offboard": long(mavlink.MAV_CMD_DO_SET_MODE, 1, 6),
        "goto": packed(goto, 245),
    }
