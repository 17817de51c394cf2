"""Set-points of an offboard controller, as velocities and positions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from .dynamics import Vector

IGNORE_POSITION, IGNORE_VELOCITY, IGNORE_ATTITUDE = 0b111, 0b111_000, 0b1000_0000
SPEED_AT_FULL_TILT_M_S, CLIMB_AT_FULL_THRUST_M_S = 10.0, 3.0
"""An attitude is flown as a velocity: enough for a link's experiment."""


@dataclass(frozen=True)
class SetPoint:
    """The last set-point of an offboard controller: a velocity or a position, both north, east, up."""

    at_s: float
    velocity: Vector | None = None
    position: Vector | None = None


def of_position_target(message: Any, now_s: float, yaw_rad: float) -> SetPoint | None:
    """The set-point of a message. A position takes precedence over a velocity; NaN or another frame counts as none."""
    local, body = mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_NED
    position, velocity = (message.x, message.y, -message.z), (message.vx, message.vy, -message.vz)
    if message.type_mask & IGNORE_POSITION == 0 and message.coordinate_frame == local and _finite(position):
        return SetPoint(now_s, position=position)
    if message.type_mask & IGNORE_VELOCITY == 0 and message.coordinate_frame in (local, body) and _finite(velocity):
        if message.coordinate_frame == body:
            velocity = (*_turned(velocity[0], velocity[1], yaw_rad), velocity[2])
        return SetPoint(now_s, velocity=velocity)
    return None


def of_attitude_target(message: Any, now_s: float) -> SetPoint | None:
    """Convert tilt to horizontal speed and thrust around hover to climb; rates alone count as level."""
    w, x, y, z = (1.0, 0.0, 0.0, 0.0) if message.type_mask & IGNORE_ATTITUDE else message.q
    size = math.sqrt(w * w + x * x + y * y + z * z)
    if not (math.isfinite(size) and size > 0.5 and 0.0 <= message.thrust <= 1.0):
        return None
    w, x, y, z = w / size, x / size, y / size, z / size
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    forward, right = -math.sin(pitch) * SPEED_AT_FULL_TILT_M_S, math.sin(roll) * SPEED_AT_FULL_TILT_M_S
    climb = (message.thrust - 0.5) * 2 * CLIMB_AT_FULL_THRUST_M_S
    return SetPoint(now_s, velocity=(*_turned(forward, right, yaw), climb))


def _turned(forward: float, right: float, yaw_rad: float) -> tuple[float, float]:
    """Turn body axes to north and east."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return forward * cos - right * sin, forward * sin + right * cos


def _finite(values: tuple[float, ...]) -> bool:
    return all(math.isfinite(value) for value in values)
