"""A drone's place, home and target, common to all kinds of autopilot."""

from __future__ import annotations

from .dynamics import Motion, Place, Vector
from .parameters import Parameters
from .setpoints import SetPoint


class Guidance:
    """One drone's motion and targets. Positions are metres north, east and up of `origin`, where it was switched on."""

    def __init__(self, origin: Place, parameters: Parameters) -> None:
        self.origin = origin
        self.home = origin
        self.parameters = parameters
        self.motion = Motion()
        self.target: Vector = (0.0, 0.0, 0.0)
        self.set_point: SetPoint | None = None
        self.lands = False
        """Whether a return has begun its landing."""
        self.cruise_m_s: float | None = None
        """The speed that a mission has set; None: the autopilot's own."""
        self._return_up_m = 0.0

    @property
    def place(self) -> Place:
        return self.origin.offset(*self.motion.position)

    @property
    def home_up_m(self) -> float:
        """Home's height above the origin."""
        return self.home.altitude_m - self.origin.altitude_m

    def home_from_here(self) -> tuple[float, float]:
        """The distance from the drone to home, north and east in metres."""
        north, east = self.origin.metres_to(self.home.latitude_deg, self.home.longitude_deg)
        return north - self.motion.position[0], east - self.motion.position[1]
