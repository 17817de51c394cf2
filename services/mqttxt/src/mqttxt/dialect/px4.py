"""PX4's custom modes (main << 16 | sub << 24) and their names, after px4_custom_mode.h."""

from __future__ import annotations

from typing import Final

from ..states import FlightModeName

_MODES: Final[dict[tuple[int, int], FlightModeName]] = {
    (1, 0): FlightModeName.MANUAL,
    (2, 0): FlightModeName.ALTITUDE,
    (3, 0): FlightModeName.POSITION,
    (3, 1): FlightModeName.ORBIT,
    (4, 2): FlightModeName.TAKEOFF,
    (4, 3): FlightModeName.HOLD,
    (4, 4): FlightModeName.MISSION,
    (4, 5): FlightModeName.RETURN,
    (4, 6): FlightModeName.LAND,
    (4, 8): FlightModeName.FOLLOW,
    (4, 9): FlightModeName.PRECISION_LAND,
    (5, 0): FlightModeName.ACRO,
    (6, 0): FlightModeName.OFFBOARD,
    (7, 0): FlightModeName.STABILIZED,
}
_NUMBERS = {name: numbers for numbers, name in _MODES.items()}


def mode_name(custom_mode: int) -> FlightModeName:
    """The name of HEARTBEAT.custom_mode; UNKNOWN for a mode that has none here."""
    return _MODES.get((custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF), FlightModeName.UNKNOWN)


def mode_numbers(name: FlightModeName) -> tuple[int, int]:
    """Main and sub mode as MAV_CMD_DO_SET_MODE takes them; raises KeyError for UNKNOWN."""
    return _NUMBERS[name]
