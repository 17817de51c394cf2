"""The velocity that each of PX4's modes demands, in metres and seconds, as PX4 flies by default."""

from __future__ import annotations

import math

from ..autopilot import FlightMode
from ..dynamics import LAG_S, Limits, Place, Vector, approach
from ..guidance import Guidance
from ..parameters import Parameters
from ..setpoints import SetPoint
from .modes import Mode

REACHED_UP_M = 0.8
"""NAV_MC_ALT_RAD: nearer than this a height counts as reached."""
STARTED_S = 0.5
"""The time from a command to its first motion."""
LANDS_S = 1.0
"""The time from the arrival at a mission's landing place to the descent."""
LIFT_S = 1.5
"""How long a goto from the ground waits for thrust."""
LIFTS_AT = 0.85
"""A takeoff lifts after this part of MPC_TKO_RAMP_T, during which thrust grows."""
TAKEOFF_S = 1.5
"""A takeoff that has nothing to climb is over after this time."""
GROUNDED_S = 3.7
"""The time on the ground after which the land detector reports a landing."""
REPOSITION_UP, REPOSITION_DOWN = 0.87, 0.87
"""The share of the automatic modes' speed at which a reposition climbs and descends: its path bends with the wind."""
ASLANT = 0.93
"""The share of its horizontal speed that it has while it climbs or descends."""
FOLLOWED = 0.86
"""The share of a velocity set-point that is reached against drag."""
RETURN_UP = 0.95
"""The share of the automatic modes' speed at which a return climbs."""
TRAILING = 0.0019
"""How much the trajectory waits for its drone, which drag holds back with the square of the speed."""


class Px4Guidance(Guidance):
    """PX4's flight in each of its modes."""

    def __init__(self, origin: Place, parameters: Parameters) -> None:
        super().__init__(origin, parameters)
        self._starts_s = 0.0

    @property
    def limits(self) -> Limits:
        """The limits of acceleration and jerk."""
        read = self.parameters
        return Limits(read["MPC_ACC_HOR"], read["MPC_ACC_UP_MAX"], read["MPC_ACC_DOWN_MAX"], read["MPC_JERK_AUTO"])

    def has_set_point(self, now_s: float) -> bool:
        """Whether an offboard controller has sent a set-point within COM_OF_LOSS_T."""
        point = self.set_point
        return point is not None and now_s - point.at_s <= self.parameters["COM_OF_LOSS_T"]

    def start(self, mode: FlightMode, now_s: float) -> None:
        """Begin a mode, or a new target of it."""
        self._starts_s = now_s + (0.0 if mode in (Mode.OFFBOARD, Mode.LAND) else STARTED_S)
        self.lands = False
        if mode is Mode.RETURN:
            self._return_up_m = self.return_up_m()

    def go(self, target: Vector, now_s: float) -> None:
        """Aim at a place."""
        self.target = target
        self.start(Mode.HOLD, now_s)

    def hold(self, before: FlightMode) -> None:
        """Stop here, but finish the climb of a return, which is a loiter to PX4."""
        climbs = before is Mode.RETURN and self.motion.position[2] < self._return_up_m - REACHED_UP_M
        self.stop_here()
        if climbs and not self.lands:
            self.target = (*self.target[:2], self._return_up_m)

    def stop_here(self) -> None:
        """Aim at the place where braking ends, so that holding does not fly back; the height stays about the same."""
        position, velocity = self.motion.position, self.motion.velocity
        limits = self.limits
        speed = self.motion.groundspeed_m_s
        ahead_s = LAG_S + speed / (2 * limits.horizontal) + limits.horizontal / (2 * limits.jerk)
        self.target = (
            position[0] + velocity[0] * ahead_s,
            position[1] + velocity[1] * ahead_s,
            max(0.0, position[2] + velocity[2] * LAG_S),
        )

    def wait(self, now_s: float) -> None:
        """Wait above a mission's landing place before the descent."""
        self._starts_s = now_s + LANDS_S

    def is_above(self, target: Vector) -> bool:
        """Whether the drone is above, below or at a mission's place, within NAV_ACC_RAD."""
        here = self.motion.position
        return math.hypot(target[0] - here[0], target[1] - here[1]) < self.parameters["NAV_ACC_RAD"]

    def is_there(self, target: Vector) -> bool:
        """Whether a place of a mission is reached."""
        return self.is_above(target) and self.is_high(target)

    def is_high(self, target: Vector) -> bool:
        """Whether the height of a place of a mission is reached."""
        return abs(target[2] - self.motion.position[2]) < REACHED_UP_M

    def takeoff_done(self, now_s: float) -> bool:
        return now_s - self._starts_s > TAKEOFF_S and self.target[2] - self.motion.position[2] < REACHED_UP_M

    def wanted_velocity(self, mode: FlightMode, now_s: float, lift_s: float, in_air: bool) -> Vector:
        """The mode's velocity north, east, up in metres per second; `lift_s`: time since the motors began to speed up.

        A takeoff in the air is a climb.
        """
        if mode is Mode.TAKEOFF and not in_air:
            return 0.0, 0.0, self._takeoff(lift_s)
        if lift_s < LIFT_S or (now_s < self._starts_s and mode is not Mode.HOLD):
            return 0.0, 0.0, 0.0
        if mode is Mode.LAND:
            return 0.0, 0.0, -self._descent_m_s()
        if mode is Mode.RETURN:
            return self._return()
        if mode is Mode.OFFBOARD and self.set_point is not None:
            return self._offboard(self.set_point)
        if now_s < self._starts_s:
            return self._kept()
        return self._towards(self.target, REPOSITION_UP, REPOSITION_DOWN)

    def _kept(self) -> Vector:
        aim = self.motion.aim
        return aim[0], aim[1], aim[2]

    def _takeoff(self, lift_s: float) -> float:
        """The climb: it lifts after LIFTS_AT of MPC_TKO_RAMP_T, and reaches MPC_TKO_SPEED one MPC_TKO_RAMP_T later."""
        ramp_s = self.parameters["MPC_TKO_RAMP_T"]
        share = 1.0 if ramp_s <= 0 else lift_s / ramp_s - LIFTS_AT
        if share <= 0:
            return 0.0
        fastest = self.parameters["MPC_TKO_SPEED"] * min(1.0, share)
        return self._up(self.target[2] - self.motion.position[2], fastest, fastest)

    def _descent_m_s(self) -> float:
        """The speed of a landing: it slows from the auto descent to the landing speed between MPC_LAND_ALT1 and 2.

        Below MPC_LAND_ALT3 it is MPC_LAND_CRWL, as with a distance sensor.
        """
        fast, slow = self.parameters["MPC_Z_V_AUTO_DN"], self.parameters["MPC_LAND_SPEED"]
        high, low = self.parameters["MPC_LAND_ALT1"], self.parameters["MPC_LAND_ALT2"]
        height = self.motion.position[2] - self.home_up_m
        if height < self.parameters["MPC_LAND_ALT3"]:
            return self.parameters["MPC_LAND_CRWL"]
        return slow + (fast - slow) * max(0.0, min(1.0, (height - low) / max(0.01, high - low)))

    def return_up_m(self) -> float:
        """The height of a return from here: RTL_RETURN_ALT, lower within a cone about home, never below the drone."""
        radius = self.parameters["NAV_ACC_RAD"]
        away_m = math.hypot(*self.home_from_here())
        height = self.parameters["RTL_RETURN_ALT"]
        if away_m <= radius:
            height = 2 * away_m
        else:
            if away_m <= self.parameters["RTL_MIN_DIST"]:
                angle = max(1.0, min(89.0, self.parameters["RTL_CONE_ANG"]))
                height = min(away_m / math.tan(math.radians(angle)), height)
            height = max(height, 2 * radius)
        return max(self.home_up_m + height, self.motion.position[2])

    def _return(self) -> Vector:
        """Climb, fly home, and land within NAV_ACC_RAD of it."""
        here = self.motion.position
        north, east = self.home_from_here()
        if not self.lands and here[2] < self._return_up_m - REACHED_UP_M:
            return 0.0, 0.0, self._up(self._return_up_m - here[2])
        self.lands = self.lands or math.hypot(north, east) <= self.parameters["NAV_ACC_RAD"]
        across = self._across(north, east)
        return (*across, -self._descent_m_s() if self.lands else self._up(self._return_up_m - here[2]))

    def _offboard(self, point: SetPoint) -> Vector:
        if point.position is not None:
            return self._towards(point.position, 1.0, 1.0)
        north, east, up = point.velocity or (0.0, 0.0, 0.0)
        speed = math.hypot(north, east)
        scale = min(1.0, self.parameters["MPC_XY_VEL_MAX"] / speed) if speed > 0 else 1.0
        up = max(-self.parameters["MPC_Z_VEL_MAX_DN"], min(self.parameters["MPC_Z_VEL_MAX_UP"], up))
        return north * scale * FOLLOWED, east * scale * FOLLOWED, up

    def _towards(self, target: Vector, share_up: float, share_down: float) -> Vector:
        here = self.motion.position
        fastest_up = self.parameters["MPC_Z_V_AUTO_UP"] * share_up
        fastest_down = self.parameters["MPC_Z_V_AUTO_DN"] * share_down
        north, east, up = target[0] - here[0], target[1] - here[1], target[2] - here[2]
        across = self._across(north, east)
        wanted_up = self._up(up, fastest_up, fastest_down)
        distance = math.hypot(north, east)
        if distance > 1.0 and abs(up) > 1.0:
            # On a straight line: neither part is over before the other.
            speed = math.hypot(*across)
            share = min(ASLANT, abs(wanted_up) / (speed * abs(up) / distance))
            across = across[0] * share, across[1] * share
            wanted_up = math.copysign(min(abs(wanted_up), speed * share * abs(up) / distance), up)
        return (*across, wanted_up)

    def _across(self, north: float, east: float) -> tuple[float, float]:
        distance = math.hypot(north, east)
        if distance < 1e-6:
            return 0.0, 0.0
        cruise = min(self.cruise_m_s or self.parameters["MPC_XY_CRUISE"], self.parameters["MPC_XY_VEL_MAX"])
        limits = self.limits
        speed = approach(distance, cruise / (1 + TRAILING * cruise * cruise), limits.horizontal, limits.jerk)
        return north * speed / distance, east * speed / distance

    def _up(self, up: float, fastest_up: float | None = None, fastest_down: float | None = None) -> float:
        limits = self.limits
        if up > 0:
            return approach(up, fastest_up or RETURN_UP * self.parameters["MPC_Z_V_AUTO_UP"], limits.down, limits.jerk)
        return approach(up, fastest_down or self.parameters["MPC_Z_V_AUTO_DN"], limits.up, limits.jerk)
