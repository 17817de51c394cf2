"""How each command is said to a PX4 autopilot, and what shows that it had its effect."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..commands import Arm, Command, Disarm, Goto, Hold, Land, Offboard, Return, Takeoff, haversine_m
from ..states import Armed, FlightMode, FlightModeName, Home, Landed, LandedState, Location
from .offboard import set_mode
from .vehicle import AUTOPILOT_COMPONENT, Vehicle

NAN = float("nan")
ARRIVED_ACROSS_M = 2.0
ARRIVED_ALTITUDE_M = 1.0
ALTITUDE_REACHED_M = 0.5
"""How far below its target altitude a takeoff counts as completed; at least 5 % of the altitude."""


class Group(Enum):
    """Commands of one group supersede each other; those without a group (None) stand alone."""

    ARMING = auto()
    MOTION = auto()


class CannotExecute(Exception):
    """Why a command cannot be said to this autopilot now; its text is the outcome's reason."""


@dataclass(frozen=True)
class Plan:
    """A command as one MAVLink message, the modes in which it runs, and the proof of its effect.

    `effect(vehicle, after)` looks only at what was received after message number `after`. `modes` None: the
    command is no flight. `passing` are modes that are right only if the effect shows soon after. `message` None:
    nothing has to be said. `on_accepted(now_ms)` is called when the command is accepted. `is_said_once`: it is never
    repeated, and its acceptance is all that will be known of it.
    """

    message: Any
    mav_cmd: int
    group: Hashable
    effect: Callable[[Vehicle, int], bool]
    modes: frozenset[FlightModeName] | None = None
    passing: frozenset[FlightModeName] = frozenset()
    on_accepted: Callable[[int], None] | None = None
    is_said_once: bool = False


def plan(command: Command, vehicle: Vehicle) -> Plan:
    """The plan of a command; raises CannotExecute where the autopilot's state does not allow to say it."""
    if isinstance(command, Arm | Disarm):
        return _arming(command, vehicle)
    if isinstance(command, Takeoff):
        return _takeoff(command, vehicle)
    if isinstance(command, Goto):
        return _goto(command, vehicle)
    if isinstance(command, Land):
        message = _long(vehicle, mavlink.MAV_CMD_NAV_LAND, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
        return Plan(message, mavlink.MAV_CMD_NAV_LAND, Group.MOTION, _is_down, frozenset({FlightModeName.LAND}))
    if isinstance(command, Hold):
        return _mode(vehicle, FlightModeName.HOLD, _holds, frozenset({FlightModeName.HOLD}))
    if isinstance(command, Offboard):
        return _mode(vehicle, FlightModeName.OFFBOARD, never, frozenset({FlightModeName.OFFBOARD}))
    assert isinstance(command, Return)
    return _mode(vehicle, FlightModeName.RETURN, _is_down, frozenset({FlightModeName.RETURN, FlightModeName.LAND}))


def _long(vehicle: Vehicle, command: int, *params: float) -> Any:
    padded = (*params, *[0.0] * (7 - len(params)))
    return mavlink.MAVLink_command_long_message(vehicle.system_id, AUTOPILOT_COMPONENT, command, 0, *padded)


def _arming(command: Arm | Disarm, vehicle: Vehicle) -> Plan:
    wanted = isinstance(command, Arm)

    def effect(seen: Vehicle, after: int) -> bool:
        return seen.seen(Armed, after) == Armed(wanted)

    message = _long(vehicle, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0 if wanted else 0.0)
    return Plan(message, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, Group.ARMING, effect)


def _home_altitude_m(vehicle: Vehicle) -> float:
    home = vehicle.seen(Home)
    if home is None:
        raise CannotExecute("home_unknown")
    return home.altitude_amsl_m


def _takeoff(command: Takeoff, vehicle: Vehicle) -> Plan:
    home_m = _home_altitude_m(vehicle)
    tolerance_m = max(ALTITUDE_REACHED_M, 0.05 * command.altitude_m)

    def effect(seen: Vehicle, after: int) -> bool:
        location, landed = seen.seen(Location, after), seen.seen(LandedState, after)
        if location is None or landed != LandedState(Landed.IN_AIR):
            return False
        return location.altitude_amsl_m - home_m >= command.altitude_m - tolerance_m

    message = _long(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF, NAN, NAN, NAN, NAN, NAN, NAN, home_m + command.altitude_m)
    return Plan(
        message,
        mavlink.MAV_CMD_NAV_TAKEOFF,
        Group.MOTION,
        effect,
        frozenset({FlightModeName.TAKEOFF}),
        frozenset({FlightModeName.HOLD}),
    )


def _goto(command: Goto, vehicle: Vehicle) -> Plan:
    target_m = _home_altitude_m(vehicle) + command.altitude_m

    def effect(seen: Vehicle, after: int) -> bool:
        location = seen.seen(Location, after)
        if location is None or abs(location.altitude_amsl_m - target_m) > ARRIVED_ALTITUDE_M:
            return False
        left_m = haversine_m(location.latitude_deg, location.longitude_deg, command.latitude_deg, command.longitude_deg)
        return left_m <= ARRIVED_ACROSS_M

    message = mavlink.MAVLink_command_int_message(
        vehicle.system_id,
        AUTOPILOT_COMPONENT,
        mavlink.MAV_FRAME_GLOBAL,
        mavlink.MAV_CMD_DO_REPOSITION,
        0,
        0,
        -1.0,
        float(mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE),
        0.0,
        NAN,
        round(command.latitude_deg * 1e7),
        round(command.longitude_deg * 1e7),
        target_m,
    )
    return Plan(message, mavlink.MAV_CMD_DO_REPOSITION, Group.MOTION, effect, frozenset({FlightModeName.HOLD}))


def _mode(
    vehicle: Vehicle,
    name: FlightModeName,
    effect: Callable[[Vehicle, int], bool],
    modes: frozenset[FlightModeName],
) -> Plan:
    return Plan(set_mode(vehicle, name), mavlink.MAV_CMD_DO_SET_MODE, Group.MOTION, effect, modes)


def never(vehicle: Vehicle, after: int) -> bool:
    """No message shows the effect."""
    return False


def _holds(vehicle: Vehicle, after: int) -> bool:
    return vehicle.seen(FlightMode, after) == FlightMode(FlightModeName.HOLD)


def _is_down(vehicle: Vehicle, after: int) -> bool:
    landed = vehicle.seen(LandedState, after) == LandedState(Landed.ON_GROUND)
    return landed and vehicle.seen(Armed, after) == Armed(False)
