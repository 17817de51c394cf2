"""Offboard set-points as MAVLink messages."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.commands import Attitude, Offboard, Velocity
from .plans import AUTOPILOT_COMPONENT
from .vehicle import Vehicle

_IGNORE_RATES = 0b111
_IGNORE_POSITION = 0b111
_IGNORE_ACCELERATION = 0b111 << 6
_IGNORE_YAW = 1 << 10
_IGNORE_YAW_RATE = 1 << 11


def set_point(command: Offboard, vehicle: Vehicle, now_ms: int, braking: bool = False) -> Any:
    """The set-point of an offboard command; `braking` asks for standstill, or for level flight at its thrust."""
    target = (now_ms % 2**32, vehicle.system_id, AUTOPILOT_COMPONENT)
    if command.velocity is not None:
        return _velocity(target, command.velocity, braking)
    assert command.attitude is not None
    return _attitude(target, command.attitude, braking)


def _velocity(target: tuple[int, int, int], wanted: Velocity, braking: bool) -> Any:
    ignored = _IGNORE_POSITION | _IGNORE_ACCELERATION | _IGNORE_YAW_RATE
    if wanted.yaw_deg is None:
        ignored |= _IGNORE_YAW
    yaw_rad = math.radians(wanted.yaw_deg or 0.0)
    velocity = (0.0, 0.0, 0.0) if braking else (wanted.north_m_s, wanted.east_m_s, wanted.down_m_s)
    frame = mavlink.MAV_FRAME_LOCAL_NED
    numbers = (0.0, 0.0, 0.0, *velocity, 0.0, 0.0, 0.0, yaw_rad, 0.0)
    return mavlink.MAVLink_set_position_target_local_ned_message(*target, frame, ignored, *numbers)


def _attitude(target: tuple[int, int, int], wanted: Attitude, braking: bool) -> Any:
    roll_deg, pitch_deg = (0.0, 0.0) if braking else (wanted.roll_deg, wanted.pitch_deg)
    turned = quaternion(roll_deg, pitch_deg, wanted.yaw_deg)
    return mavlink.MAVLink_set_attitude_target_message(*target, _IGNORE_RATES, turned, 0.0, 0.0, 0.0, wanted.thrust)


def quaternion(roll_deg: float, pitch_deg: float, yaw_deg: float) -> list[float]:
    """w, x, y, z of a rotation by yaw, then pitch, then roll."""
    half = [math.radians(angle) / 2 for angle in (roll_deg, pitch_deg, yaw_deg)]
    (cr, cp, cy), (sr, sp, sy) = [math.cos(angle) for angle in half], [math.sin(angle) for angle in half]
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
