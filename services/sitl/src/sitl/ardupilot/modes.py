"""ArduCopter's flight modes."""

from __future__ import annotations

from ..autopilot import FlightMode


class Mode(FlightMode):
    """Those of ArduCopter's modes that the stand-in has, by their numbers."""

    STABILIZE = 0
    ACRO = 1
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17

    @property
    def custom_mode(self) -> int:
        """Its number."""
        return int(self.value)


UNPOWERED = frozenset({Mode.STABILIZE, Mode.ACRO})
"""The throttle stick is the thrust: it is at the bottom, so the drone falls."""
SINKING = frozenset({Mode.ALT_HOLD, Mode.LOITER, Mode.POSHOLD})
"""The throttle stick is the climb: at the bottom it descends."""
ROOTED = frozenset({Mode.LOITER, Mode.POSHOLD})
"""A takeoff is accepted, but the stick at the bottom keeps the drone on the ground."""
ARMABLE = frozenset({Mode.STABILIZE, Mode.ACRO, Mode.ALT_HOLD, Mode.GUIDED, Mode.LOITER, Mode.POSHOLD})
