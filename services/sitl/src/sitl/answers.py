"""Parts of answers to commands, common to all kinds of autopilot: results, COMMAND_ACK, and the command's event."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from .outputs import Happened

ACCEPTED, DENIED = int(mavlink.MAV_RESULT_ACCEPTED), int(mavlink.MAV_RESULT_DENIED)
REJECTED = int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
UNSUPPORTED = int(mavlink.MAV_RESULT_UNSUPPORTED)
FAILED = int(mavlink.MAV_RESULT_FAILED)
IN_PROGRESS = int(mavlink.MAV_RESULT_IN_PROGRESS)
FORCE = 21196.0
"""param2 of MAV_CMD_COMPONENT_ARM_DISARM that forces it."""


def received(message: Any) -> Happened:
    """The event of a received command: its number and seven parameters, null for NaN and infinities."""
    first = (message.param1, message.param2, message.param3, message.param4)
    in_int = message.get_type() == "COMMAND_INT"
    last = (message.x, message.y, message.z) if in_int else (message.param5, message.param6, message.param7)
    params = [param if math.isfinite(param) else None for param in (*first, *last)]
    return Happened("command", {"command": message.command, "params": params, "from": message.get_srcSystem()})


def acknowledgement(message: Any, result: int, progress: int = 0) -> mavlink.MAVLink_command_ack_message:
    """COMMAND_ACK to the sender of the command; `progress` in percent, 255 for unknown."""
    return mavlink.MAVLink_command_ack_message(
        command=message.command,
        result=result,
        progress=progress,
        result_param2=0,
        target_system=message.get_srcSystem(),
        target_component=message.get_srcComponent(),
    )


def whole(value: float) -> int | None:
    """A parameter that carries an integer; None for NaN and infinities."""
    return int(value) if math.isfinite(value) else None
