"""The velocity that each of ArduCopter's modes demands, in metres and seconds, as it flies by default."""

from __future__ import annotations

import math

from ..autopilot import FlightMode
from ..dynamics import Limits, Place, Vector, approach
from ..guidance import Guidance
from ..parameters import Parameters
from .modes import SINKING, Mode

WAYPOINT_M_S3 = 1.0
"""WPNAV_JERK: between the places of a mission."""
REACHED_M = 2.0
"""WPNAV_RADIUS: a place of a mission that is nearer than this is reached."""
PASSED_M = 3.0
"""The same for a place where it does not stop."""
REACHED_UP_M = 0.5
"""A takeoff that is nearer than this to its height is over."""
RETURNED_M = 0.2
"""A return's climb, or its way home, is over when the drone is nearer than this to its end."""
STANDS_M_S = 0.2
"""Below this speed braking is over."""
BRAKING, BRAKING_UP = 0.75, 0.75
"""The shares of its acceleration with which it brakes towards a place, and towards a height."""
BRAKE_S, BRAKE_M_S2 = 1.5, 0.5
"""BRAKE decelerates by its speed divided by this time, but at least by this acceleration."""
TURNING_RAD_S2 = math.radians(180)
LOWEST_RETURN_M, LEAST_CLIMB_M = 2.0, 2.5
"""A return's lowest height, and the least climb that the cone about home leaves it."""
LEAST_SLOPE = 0.5
"""A flatter cone about home is ignored."""


class CopterGuidance(Guidance):
    """ArduCopter's flight in each of its modes."""

    def __init__(self, origin: Place, parameters: Parameters) -> None:
        super().__init__(origin, parameters)
        self._brakes = False
        self._home_s: float | None = None
        """When a return came to rest above home."""

    def limits(self, mode: FlightMode) -> Limits:
        """A mode's limits of acceleration and jerk. A return does not turn (WP_YAW_BEHAVIOR)."""
        up = self._m("PILOT_ACCEL_Z" if mode in SINKING else "WPNAV_ACCEL_Z")
        across, jerk = self._m("WPNAV_ACCEL"), self.parameters["PSC_JERK_XY"]
        if mode is Mode.BRAKE:
            across = max(BRAKE_M_S2, self.motion.groundspeed_m_s / BRAKE_S)
        turning_rad_s2 = 0.0 if mode is Mode.RTL else TURNING_RAD_S2
        if mode is Mode.AUTO:
            jerk = WAYPOINT_M_S3
        return Limits(across, up, up, jerk, waits=False, turning_rad_s2=turning_rad_s2)

    def stop(self) -> None:
        """Brake, then stay at the place where braking ended."""
        self.set_point = None
        self._brakes = True

    def go(self, target: Vector) -> None:
        """Aim at a place."""
        self.set_point, self.target, self._brakes = None, target, False

    def start_return(self) -> None:
        """Begin a return: compute the height to which it climbs first."""
        here = self.motion.position[2]
        height = max(LOWEST_RETURN_M, self._m("RTL_ALT"), here - self.home_up_m + self._m("RTL_CLIMB_MIN"))
        up_m = self.home_up_m + height
        slope = self.parameters["RTL_CONE_SLOPE"]
        if slope >= LEAST_SLOPE:
            cone_m = self.home_up_m + math.hypot(*self.home_from_here()) * slope
            up_m = max(here, min(up_m, max(cone_m, here + LEAST_CLIMB_M)))
        self._return_up_m = up_m
        self.lands, self._home_s = False, None

    def is_above(self, target: Vector) -> bool:
        """Whether it is over a place of a mission."""
        here = self.motion.position
        return math.hypot(target[0] - here[0], target[1] - here[1]) < REACHED_M

    def is_there(self, target: Vector, stops: bool) -> bool:
        """Whether a mission's place is reached; one without a stop counts earlier, as the path rounds the corner."""
        return math.dist(self.motion.position, target) < (REACHED_M if stops else PASSED_M)

    def is_near(self, up_m: float) -> bool:
        """Whether a height is reached from below."""
        return up_m - self.motion.position[2] < REACHED_UP_M

    def wanted_velocity(self, mode: FlightMode, now_s: float) -> Vector:
        """The mode's velocity north, east, up in metres per second."""
        if mode in SINKING:
            return 0.0, 0.0, -self._m("PILOT_SPEED_UP")
        if mode is Mode.LAND:
            return (*self._stay()[:2], -self._descent_m_s())
        if mode is Mode.RTL:
            return self._return(now_s)
        if self.set_point is not None:
            return self._velocity(now_s)
        return self._stay(Mode.AUTO if mode is Mode.AUTO else Mode.GUIDED)

    def _stay(self, mode: FlightMode = Mode.GUIDED) -> Vector:
        """Fly to the target; after braking, that is the place where it ended."""
        if self._brakes and self.motion.groundspeed_m_s + abs(self.motion.velocity[2]) > STANDS_M_S:
            return 0.0, 0.0, 0.0
        if self._brakes:
            north, east, up = self.motion.position
            self.target, self._brakes = (north, east, up), False
        return self._towards(self.target, mode)

    def _m(self, name: str) -> float:
        """A parameter in centimetres, converted to metres."""
        return self.parameters[name] / 100

    def _velocity(self, now_s: float) -> Vector:
        """The velocity that a controller has set; 0 once it has been silent for GUID_TIMEOUT."""
        point = self.set_point
        if point is None or now_s - point.at_s > self.parameters["GUID_TIMEOUT"]:
            return 0.0, 0.0, 0.0
        north, east, up = point.velocity or (0.0, 0.0, 0.0)
        speed = math.hypot(north, east)
        scale = min(1.0, self._m("WPNAV_SPEED") / speed) if speed > 0 else 1.0
        up = max(-self._m("WPNAV_SPEED_DN"), min(self._m("WPNAV_SPEED_UP"), up))
        return north * scale, east * scale, up

    def _return(self, now_s: float) -> Vector:
        """Climb, fly home, wait there RTL_LOIT_TIME, and land."""
        north, east = self.home_from_here()
        up = self._return_up_m - self.motion.position[2]
        if self.lands:
            return (*self._towards((*self._home(), 0.0))[:2], -self._descent_m_s())
        if self._home_s is None and up > RETURNED_M:
            return 0.0, 0.0, self._up(up, self._m("WPNAV_SPEED_UP"))
        if self._home_s is None and math.hypot(north, east) <= RETURNED_M:
            self._home_s = now_s
        self.lands = self._home_s is not None and now_s - self._home_s >= self.parameters["RTL_LOIT_TIME"] / 1000
        return self._towards((*self._home(), self._return_up_m))

    def _home(self) -> tuple[float, float]:
        return self.origin.metres_to(self.home.latitude_deg, self.home.longitude_deg)

    def _descent_m_s(self) -> float:
        """WPNAV_SPEED_DN, or LAND_SPEED_HIGH if that is set, down to LAND_ALT_LOW above home; then LAND_SPEED."""
        slow = self._m("LAND_SPEED")
        fast = self._m("LAND_SPEED_HIGH") or self._m("WPNAV_SPEED_DN")
        above_m = self.motion.position[2] - self.home_up_m - self._m("LAND_ALT_LOW")
        return max(slow, min(fast, abs(self._up(-max(0.0, above_m), fast))))

    def _towards(self, target: Vector, mode: FlightMode = Mode.GUIDED) -> Vector:
        """Fly on a straight line, as fast as the horizontal and vertical limits allow together."""
        here = self.motion.position
        north, east, up = target[0] - here[0], target[1] - here[1], target[2] - here[2]
        across, size = math.hypot(north, east), math.hypot(north, east, up)
        if size < 1e-6:
            return 0.0, 0.0, 0.0
        climb = self._m("WPNAV_SPEED_UP" if up > 0 else "WPNAV_SPEED_DN")
        cruise = self.cruise_m_s or self._m("WPNAV_SPEED")
        fastest = min(cruise * size / max(across, 1e-6), climb * size / max(abs(up), 1e-6))
        limits = self.limits(mode)
        speed = approach(across, max(0.1, fastest * across / size), BRAKING * limits.horizontal, limits.jerk)
        share = speed / max(across, 1e-6)
        return north * share, east * share, self._up(up, max(0.1, fastest * abs(up) / size))

    def _up(self, up_m: float, fastest_m_s: float) -> float:
        limits = self.limits(Mode.GUIDED)
        return approach(up_m, fastest_m_s, BRAKING_UP * limits.up, limits.jerk)
