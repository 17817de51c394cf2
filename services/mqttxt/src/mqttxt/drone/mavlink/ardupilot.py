"""ArduCopter: its modes (after ArduPilot's Copter mode numbers), and how commands are written to it.

No field of any message is ever NaN: ArduCopter of May 2024 ends with a floating point exception on a NaN in
NAV_TAKEOFF.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Final

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.commands import Arm, Command, Disarm, Goto, Hold, Land, Offboard, Return, Takeoff
from ...protocol.states import Armed, FlightMode, FlightModeName, Health, Landed
from .autopilot import Autopilot
from .plans import (
    CannotExecute,
    Group,
    Plan,
    arming,
    climbed,
    command_long,
    holds,
    home_altitude_m,
    is_down,
    landed_state,
    never,
    reposition,
)

if TYPE_CHECKING:
    from .vehicle import Vehicle

_MODES: Final[dict[int, FlightModeName]] = {
    0: FlightModeName.STABILIZED,
    1: FlightModeName.ACRO,
    2: FlightModeName.ALTITUDE,
    3: FlightModeName.MISSION,
    4: FlightModeName.GUIDED,
    5: FlightModeName.LOITER,
    6: FlightModeName.RETURN,
    7: FlightModeName.CIRCLE,
    9: FlightModeName.LAND,
    11: FlightModeName.DRIFT,
    13: FlightModeName.SPORT,
    14: FlightModeName.FLIP,
    15: FlightModeName.AUTOTUNE,
    16: FlightModeName.POSHOLD,
    17: FlightModeName.BRAKE,
    18: FlightModeName.THROW,
    19: FlightModeName.AVOID_ADSB,
    20: FlightModeName.GUIDED_NOGPS,
    21: FlightModeName.SMART_RTL,
    22: FlightModeName.FLOWHOLD,
    23: FlightModeName.FOLLOW,
    24: FlightModeName.ZIGZAG,
    25: FlightModeName.SYSTEMID,
    26: FlightModeName.AUTOROTATE,
    27: FlightModeName.AUTO_RTL,
    28: FlightModeName.TURTLE,
}
_NUMBERS: Final = {name: number for number, name in _MODES.items()}
_ARMABLE: Final = frozenset(
    {
        FlightModeName.STABILIZED,
        FlightModeName.ALTITUDE,
        FlightModeName.LOITER,
        FlightModeName.POSHOLD,
        FlightModeName.GUIDED,
    }
)
"""Modes in which it arms and then stays on the ground. After a landing it is in LAND or RTL, where it refuses to."""


class ArduCopter(Autopilot):
    """A multicopter with ArduPilot.

    GUIDED is where it takes off, goes to a position and follows set-points; BRAKE is where it holds. Other modes
    that stay in place (LOITER, POSHOLD) obey the sticks, and without a remote control they descend: measured 2.5 m/s.
    """

    name = "ArduPilot's multicopters"
    types: ClassVar = frozenset(
        {
            mavlink.MAV_TYPE_QUADROTOR,
            mavlink.MAV_TYPE_HEXAROTOR,
            mavlink.MAV_TYPE_OCTOROTOR,
            mavlink.MAV_TYPE_TRICOPTER,
            mavlink.MAV_TYPE_DODECAROTOR,
            mavlink.MAV_TYPE_DECAROTOR,
        }
    )
    max_speed: ClassVar = {"WPNAV_SPEED": 0.01, "WP_SPD": 1.0}
    cruise_speed: ClassVar = {"WPNAV_SPEED": 0.01, "WP_SPD": 1.0}
    hold_mode = FlightModeName.BRAKE
    offboard_mode = FlightModeName.GUIDED
    is_offboard_alone = False
    priming = 0
    refuses_as_failed = True
    explains_afterwards = True

    def flight_mode(self, heartbeat: Any) -> FlightModeName:
        return _MODES.get(heartbeat.custom_mode, FlightModeName.UNKNOWN)

    def health(self, status: Any) -> Health:
        known = status.onboard_control_sensors_present & status.onboard_control_sensors_enabled
        unhealthy = known & ~status.onboard_control_sensors_health & 0xFFFFFFFF
        prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        return Health(bool(known & prearm) and not unhealthy & prearm, unhealthy)

    def set_mode(self, vehicle: Vehicle, name: FlightModeName) -> Any:
        custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        return command_long(vehicle, mavlink.MAV_CMD_DO_SET_MODE, custom, float(_NUMBERS[name]))

    def plan(self, command: Command, vehicle: Vehicle, now_ms: int) -> Plan:
        if isinstance(command, Arm):
            mode, is_armed = vehicle.seen(FlightMode), vehicle.seen(Armed) == Armed(True)
            stays = is_armed or (mode is not None and mode.mode in _ARMABLE)
            return replace(arming(command, vehicle), first_mode=None if stays else FlightModeName.GUIDED)
        if isinstance(command, Disarm):
            return arming(command, vehicle)
        if isinstance(command, Takeoff):
            return _takeoff(command, vehicle, now_ms)
        if isinstance(command, Goto):
            return _goto(command, vehicle)
        if isinstance(command, Land):
            message = command_long(vehicle, mavlink.MAV_CMD_NAV_LAND)
            return Plan(message, mavlink.MAV_CMD_NAV_LAND, Group.MOTION, is_down, frozenset({FlightModeName.LAND}))
        if isinstance(command, Hold):
            return self._mode(vehicle, self.hold_mode, holds)
        if isinstance(command, Offboard):
            return self._mode(vehicle, self.offboard_mode, never)
        assert isinstance(command, Return)
        return self._mode(vehicle, FlightModeName.RETURN, is_down)


def _takeoff(command: Takeoff, vehicle: Vehicle, now_ms: int) -> Plan:
    """NAV_TAKEOFF takes the height above home. In LOITER it would be accepted too, and not be flown.

    In the air ArduCopter refuses it; entering GUIDED for it would only take the drone from its pilot.
    """
    if landed_state(vehicle, now_ms) not in (Landed.UNDEFINED, Landed.ON_GROUND):
        raise CannotExecute("in_air")
    return Plan(
        command_long(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF, *[0.0] * 6, command.altitude_m),
        mavlink.MAV_CMD_NAV_TAKEOFF,
        Group.MOTION,
        climbed(command, home_altitude_m(vehicle)),
        modes=frozenset({FlightModeName.GUIDED}),
        first_mode=FlightModeName.GUIDED,
    )


def _goto(command: Goto, vehicle: Vehicle) -> Plan:
    """DO_REPOSITION above home, into GUIDED; SET_POSITION_TARGET_GLOBAL_INT does the same, unacknowledged."""
    return reposition(command, vehicle, mavlink.MAV_FRAME_GLOBAL, 0.0, FlightModeName.GUIDED)
