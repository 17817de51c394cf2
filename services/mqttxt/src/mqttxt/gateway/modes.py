"""Flight modes as MAVLink clients name them, and the commands that lead to them."""

from __future__ import annotations

from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from ..drone.mavlink import ardupilot, px4
from ..protocol.commands import Command, Hold, Land, Return
from ..protocol.states import FlightModeName

PX4, ARDUPILOT = int(mavlink.MAV_AUTOPILOT_PX4), int(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)

_AUTO = frozenset(
    {
        FlightModeName.HOLD, FlightModeName.MISSION, FlightModeName.RETURN, FlightModeName.LAND,
        FlightModeName.TAKEOFF, FlightModeName.FOLLOW, FlightModeName.PRECISION_LAND, FlightModeName.OFFBOARD,
    }
)  # fmt: skip
_BY_ITSELF = mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
_COMMANDS: Final[dict[int, dict[FlightModeName, Command]]] = {
    PX4: {FlightModeName.HOLD: Hold(), FlightModeName.LAND: Land(), FlightModeName.RETURN: Return()},
    ARDUPILOT: {
        # GUIDED without a position means to stay: takeoff and goto enter the mode themselves.
        FlightModeName.GUIDED: Hold(),
        FlightModeName.BRAKE: Hold(),
        FlightModeName.LAND: Land(),
        FlightModeName.RETURN: Return(),
    },
}


def custom_mode(autopilot: int, mode: FlightModeName) -> int | None:
    """HEARTBEAT.custom_mode; None for a mode that has no name here, and for other kinds of autopilots."""
    if mode is FlightModeName.UNKNOWN or autopilot not in _COMMANDS:
        return None
    try:
        if autopilot == ARDUPILOT:
            return ardupilot.mode_number(mode)
        main, sub = px4.mode_numbers(mode)
    except KeyError:
        return None
    return main << 16 | sub << 24


def base_mode(autopilot: int, mode: FlightModeName, armed: bool) -> int:
    """HEARTBEAT.base_mode: armed or not, and for PX4 whether it flies itself, by which clients name its modes."""
    flags = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    if custom_mode(autopilot, mode) is None:
        return int(flags)
    flags |= mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    if autopilot == PX4:
        flags |= _BY_ITSELF if mode in _AUTO else mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    return int(flags)


def command_for(autopilot: int, mode: FlightModeName) -> Command | None:
    """The command that leads to a mode; None if there is none."""
    return _COMMANDS.get(autopilot, {}).get(mode)


def commandable(autopilot: int) -> str:
    """The names of the modes that have a command; MISSION's command names the mission."""
    modes = _COMMANDS.get(autopilot, {})
    return ", ".join(mode.name for mode in (*modes, *([FlightModeName.MISSION] if modes else []))) or "none"


def mode_of(autopilot: int, custom_mode: int) -> FlightModeName:
    """The mode of a HEARTBEAT's or SET_MODE's custom_mode; UNKNOWN for one that has no name here."""
    return ardupilot.mode_name(custom_mode) if autopilot == ARDUPILOT else px4.mode_name(custom_mode)


def mode_of_command(autopilot: int, main: int, sub: int) -> FlightModeName:
    """The mode that a DO_SET_MODE names, in one number or, for PX4, two; UNKNOWN for one that has no name here."""
    if autopilot == ARDUPILOT:
        return mode_of(autopilot, main)
    is_byte = 0 <= main <= 0xFF and 0 <= sub <= 0xFF
    return mode_of(autopilot, main << 16 | sub << 24) if is_byte else FlightModeName.UNKNOWN
