"""PX4's flight modes."""

from __future__ import annotations

from ..autopilot import FlightMode


class Mode(FlightMode):
    """PX4's modes as (main, sub) of custom_mode."""

    MANUAL = (1, 0)
    ALTITUDE = (2, 0)
    POSITION = (3, 0)
    TAKEOFF = (4, 2)
    HOLD = (4, 3)
    MISSION = (4, 4)
    RETURN = (4, 5)
    LAND = (4, 6)
    ACRO = (5, 0)
    OFFBOARD = (6, 0)
    STABILIZED = (7, 0)

    @property
    def custom_mode(self) -> int:
        """main << 16 | sub << 24, as HEARTBEAT carries it."""
        return self.value[0] << 16 | self.value[1] << 24


NEEDS_STICKS = frozenset({Mode.MANUAL, Mode.ALTITUDE, Mode.POSITION, Mode.ACRO, Mode.STABILIZED})
"""Modes that need a pilot's sticks, which the stand-in does not have."""
