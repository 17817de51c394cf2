"""ArduCopter: its modes (after ArduPilot's Copter mode numbers), and how commands are written to it.

No field of a command is ever NaN: ArduCopter of May 2024 ends with a floating point exception on one in NAV_TAKEOFF,
CONDITION_YAW and others. It refuses mission items with an unexpected NaN, but accepts such items of a fence.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Final

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.commands import Takeoff
from ...protocol.plans import PlanItem
from ...protocol.states import FlightMode, FlightModeName, Health, Landed
from .autopilot import Autopilot
from .plans import (
    CannotExecute,
    CommandPlan,
    Group,
    climbed,
    command_long,
    holds,
    home_altitude_m,
    landed_state,
    never,
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
_KEPT: Final[dict[int, tuple[int, ...]]] = {
    mavlink.MAV_CMD_NAV_WAYPOINT: (0,),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: (),
    mavlink.MAV_CMD_NAV_LOITER_TIME: (0, 2, 3),
    mavlink.MAV_CMD_NAV_LAND: (0,),
    mavlink.MAV_CMD_NAV_TAKEOFF: (0,),
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: (),
    mavlink.MAV_CMD_DO_CHANGE_SPEED: (0, 1, 2),
    mavlink.MAV_CMD_DO_JUMP: (0, 1),
    mavlink.MAV_CMD_NAV_RALLY_POINT: (),
}
"""The parameters, from 0, that ArduCopter keeps of these items; of others all."""


def mode_name(custom_mode: int) -> FlightModeName:
    """The name of HEARTBEAT.custom_mode; UNKNOWN for a mode without a FlightModeName."""
    return _MODES.get(custom_mode, FlightModeName.UNKNOWN)


def mode_number(name: FlightModeName) -> int:
    """HEARTBEAT.custom_mode of a mode. Raises KeyError for one that ArduCopter does not have."""
    return _NUMBERS[name]


class ArduCopter(Autopilot):
    """A multicopter with ArduPilot.

    It takes off, flies to a position and follows set-points in GUIDED, and holds in BRAKE. Other modes that stay in
    place (LOITER, POSHOLD) obey the sticks, and descend without a remote control, at 2.5 m/s as measured.
    """

    name = "ArduPilot's multicopters"
    ends_on_nan = True
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
    ready_mode = FlightModeName.GUIDED
    stays_armed_in: ClassVar = frozenset(
        {
            FlightModeName.STABILIZED,
            FlightModeName.ALTITUDE,
            FlightModeName.LOITER,
            FlightModeName.POSHOLD,
            FlightModeName.GUIDED,
        }
    )
    """After a landing it is in LAND or RTL, and refuses to arm."""
    goto_frame = mavlink.MAV_FRAME_GLOBAL
    """DO_REPOSITION above home; SET_POSITION_TARGET_GLOBAL_INT does the same without acknowledgement."""
    is_offboard_alone = False
    priming = 0
    refuses_as_failed = True
    explains_afterwards = True
    home_items = 1
    bytewise = False
    tells_of_fence = True

    def flight_mode(self, heartbeat: Any) -> FlightModeName:
        return mode_name(heartbeat.custom_mode)

    def health(self, status: Any) -> Health:
        known = status.onboard_control_sensors_present & status.onboard_control_sensors_enabled
        unhealthy = known & ~status.onboard_control_sensors_health & 0xFFFFFFFF
        prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        return Health(bool(known & prearm) and not unhealthy & prearm, unhealthy)

    def set_mode(self, vehicle: Vehicle, name: FlightModeName) -> Any:
        custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        return command_long(vehicle, mavlink.MAV_CMD_DO_SET_MODE, custom, float(_NUMBERS[name]))

    def kept(self, item: PlanItem) -> PlanItem:
        """The parameters that it uses; the frame is left out for an item without a position."""
        kept = _KEPT.get(item.command, range(4))
        params = [param if place in kept else 0.0 for place, param in enumerate(item.params)]
        if item.command == mavlink.MAV_CMD_NAV_LOITER_TIME:  # the direction, and whether it leaves by the tangent
            params[2:] = [-1.0 if (params[2] or 0.0) < 0 else 1.0, float((params[3] or 0.0) > 0)]
        frame = mavlink.MAV_FRAME_GLOBAL if item.frame == mavlink.MAV_FRAME_MISSION else item.frame
        return replace(item, frame=frame, params=tuple(params))

    def has_ended(self, vehicle: Vehicle, after: int) -> bool:
        """After a mission it stays in its mode and stands still."""
        return vehicle.is_still(after)

    def _takeoff(self, command: Takeoff, vehicle: Vehicle, now_ms: int) -> CommandPlan:
        """NAV_TAKEOFF with the height above home, in GUIDED. In LOITER it would be accepted and not flown.

        In the air ArduCopter refuses it; entering GUIDED for it would only take the drone from its pilot.
        """
        landed = landed_state(vehicle, now_ms)
        if landed not in (Landed.UNDEFINED, Landed.ON_GROUND):
            raise CannotExecute("in_air")
        if landed is Landed.UNDEFINED and vehicle.seen(FlightMode) != FlightMode(FlightModeName.GUIDED):
            raise CannotExecute("landed_state_unknown")
        return CommandPlan(
            command_long(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF, *[0.0] * 6, command.altitude_m),
            mavlink.MAV_CMD_NAV_TAKEOFF,
            Group.MOTION,
            climbed(command, home_altitude_m(vehicle)),
            modes=frozenset({FlightModeName.GUIDED}),
            first_mode=FlightModeName.GUIDED,
        )

    def _hold(self, vehicle: Vehicle, now_ms: int) -> CommandPlan:
        return self._mode(vehicle, self.hold_mode, holds)

    def _mission(self, vehicle: Vehicle) -> CommandPlan:
        message = command_long(vehicle, mavlink.MAV_CMD_MISSION_START)
        return CommandPlan(message, mavlink.MAV_CMD_MISSION_START, Group.MOTION, never)
