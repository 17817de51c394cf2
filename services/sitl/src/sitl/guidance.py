"""Where a drone wants to go: the velocity that each mode asks for, in metres and seconds."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .dynamics import VERTICAL_ACCELERATION_M_S2, Motion, Place, Vector, approach
from .modes import Mode
from .parameters import Parameters

CLOSE_M = 0.3
"""Nearer than this a height or a place counts as reached."""
AT_HOME_M = 1.0
"""A return lands when it is this near to home, at once where it starts so near."""
FALL_M_S = -10.0
"""What is left of flight when the motors are stopped in the air."""


@dataclass(frozen=True)
class SetPoint:
    """What an offboard controller last asked for: a velocity or a position, both north, east, up."""

    at_s: float
    velocity: Vector | None = None
    position: Vector | None = None


class Guidance:
    """One drone's motion and aims. Positions are metres north, east and up of `origin`, where it was switched on."""

    def __init__(self, origin: Place, parameters: Parameters) -> None:
        self.origin = origin
        self.home = origin
        self.parameters = parameters
        self.motion = Motion()
        self.target: Vector = (0.0, 0.0, 0.0)
        self.set_point: SetPoint | None = None

    @property
    def place(self) -> Place:
        return self.origin.offset(*self.motion.position)

    @property
    def home_up_m(self) -> float:
        """Home's height over the origin."""
        return self.home.altitude_m - self.origin.altitude_m

    def has_set_point(self, now_s: float) -> bool:
        """Whether an offboard controller was heard within COM_OF_LOSS_T."""
        point = self.set_point
        return point is not None and now_s - point.at_s <= self.parameters["COM_OF_LOSS_T"]

    def stop_here(self) -> None:
        """Aim at where braking ends, so that holding does not fly back."""
        position, velocity = self.motion.position, self.motion.velocity
        ahead_s = self.motion.groundspeed_m_s / (2 * self.parameters["MPC_ACC_HOR"])
        ahead_up_s = abs(velocity[2]) / (2 * VERTICAL_ACCELERATION_M_S2)
        self.target = (
            position[0] + velocity[0] * ahead_s,
            position[1] + velocity[1] * ahead_s,
            max(0.0, position[2] + velocity[2] * ahead_up_s),
        )

    def takeoff_done(self) -> bool:
        return self.target[2] - self.motion.position[2] < CLOSE_M

    def wanted_velocity(self, mode: Mode, landed: bool) -> Vector:
        """North, east, up in metres a second; before the limits of acceleration."""
        if landed and mode not in (Mode.TAKEOFF, Mode.OFFBOARD):
            return 0.0, 0.0, 0.0
        if mode is Mode.TAKEOFF:
            left_m = self.target[2] - self.motion.position[2]
            return 0.0, 0.0, approach(left_m, self.parameters["MPC_TKO_SPEED"], VERTICAL_ACCELERATION_M_S2)
        if mode is Mode.LAND:
            return 0.0, 0.0, -self._descent_m_s()
        if mode is Mode.RETURN:
            return self._return()
        if mode is Mode.OFFBOARD and self.set_point is not None:
            return self._offboard(self.set_point)
        return self._towards(self.target)

    def _descent_m_s(self) -> float:
        """Slowing from the auto descent to the landing speed between MPC_LAND_ALT1 and MPC_LAND_ALT2."""
        fast, slow = self.parameters["MPC_Z_V_AUTO_DN"], self.parameters["MPC_LAND_SPEED"]
        high, low = self.parameters["MPC_LAND_ALT1"], self.parameters["MPC_LAND_ALT2"]
        share = (self.motion.position[2] - self.home_up_m - low) / max(0.01, high - low)
        return slow + (fast - slow) * max(0.0, min(1.0, share))

    def _return(self) -> Vector:
        """Climb to RTL_RETURN_ALT, fly home, land there."""
        north, east = self.origin.metres_to(self.home.latitude_deg, self.home.longitude_deg)
        here = self.motion.position
        height = self.home_up_m + self.parameters["RTL_RETURN_ALT"]
        away_m = math.hypot(north - here[0], east - here[1])
        if away_m <= AT_HOME_M:
            return (*self._towards((north, east, here[2]))[:2], -self._descent_m_s())
        if here[2] < height - CLOSE_M:
            return self._towards((here[0], here[1], height))
        return self._towards((north, east, max(here[2], height)))

    def _offboard(self, point: SetPoint) -> Vector:
        if point.position is not None:
            return self._towards(point.position)
        north, east, up = point.velocity or (0.0, 0.0, 0.0)
        speed = math.hypot(north, east)
        scale = min(1.0, self.parameters["MPC_XY_VEL_MAX"] / speed) if speed > 0 else 1.0
        up = max(-self.parameters["MPC_Z_VEL_MAX_DN"], min(self.parameters["MPC_Z_VEL_MAX_UP"], up))
        return north * scale, east * scale, up

    def _towards(self, target: Vector) -> Vector:
        north, east = target[0] - self.motion.position[0], target[1] - self.motion.position[1]
        distance = math.hypot(north, east)
        fastest = min(self.parameters["MPC_XY_CRUISE"], self.parameters["MPC_XY_VEL_MAX"])
        speed = approach(distance, fastest, self.parameters["MPC_ACC_HOR"])
        up = target[2] - self.motion.position[2]
        limit = self.parameters["MPC_Z_V_AUTO_UP" if up > 0 else "MPC_Z_V_AUTO_DN"]
        share = speed / distance if distance > 1e-6 else 0.0
        return north * share, east * share, approach(up, limit, VERTICAL_ACCELERATION_M_S2)
