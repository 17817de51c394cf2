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
    boot_ms, system = now_ms % 2**32, vehicle.system_id
    if command.velocity is not None:
        return _velocity(boot_ms, system, command.velocity, braking)
    assert command.attitude is not None
    return _attitude(boot_ms, system, command.attitude, braking)


def _velocity(boot_ms: int, system: int, wanted: Velocity, braking: bool) -> Any:
    ignored = _IGNORE_POSITION | _IGNORE_ACCELERATION | _IGNORE_YAW_RATE
    if wanted.yaw_deg is None:
        ignored |= _IGNORE_YAW
    yaw_rad = math.radians(wanted.yaw_deg or 0.0)
    north_m_s, east_m_s, down_m_s = (0.0, 0.0, 0.0) if braking else (wanted.north_m_s, wanted.east_m_s, wanted.down_m_s)
    return mavlink.MAVLink_set_position_target_local_ned_message(
        time_boot_ms=boot_ms,
        target_system=system,
        target_component=AUTOPILOT_COMPONENT,
        coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED,
        type_mask=ignored,
        x=0.0,
        y=0.0,
        z=0.0,
        vx=north_m_s,
        vy=east_m_s,
        vz=down_m_s,
        afx=0.0,
        afy=0.0,
        afz=0.0,
        yaw=yaw_rad,
        yaw_rate=0.0,
    )


def _attitude(boot_ms: int, system: int, wanted: Attitude, braking: bool) -> Any:
    roll_deg, pitch_deg = (0.0, 0.0) if braking else (wanted.roll_deg, wanted.pitch_deg)
    turned = quaternion(roll_deg, pitch_deg, wanted.yaw_deg)
    return mavlink.MAVLink_set_attitude_target_message(
        time_boot_ms=boot_ms,
        target_system=system,
        target_component=AUTOPILOT_COMPONENT,
        type_mask=_IGNORE_RATES,
        q=turned,
        body_roll_rate=0.0,
        body_pitch_rate=0.0,
        body_yaw_rate=0.0,
        thrust=wanted.thrust,
    )


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
