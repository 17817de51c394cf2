"""PX4: its custom modes (main << 16 | sub << 24, after px4_custom_mode.h), and how commands are written to it."""

from __future__ import annotations

import math
import re
import struct
import zlib
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Final

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.commands import Takeoff
from ...protocol.parameters import ParameterSet
from ...protocol.plans import PlanItem
from ...protocol.states import Armed, FlightMode, FlightModeName, Health, Landed
from .autopilot import Autopilot
from .plans import (
    ALTITUDE_NEAR_M,
    NAN,
    CommandPlan,
    Group,
    above,
    climbed,
    command_long,
    holds,
    home_altitude_m,
    is_disarmed,
    landed_state,
    never,
)

if TYPE_CHECKING:
    from .vehicle import Vehicle

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
    """The name of HEARTBEAT.custom_mode; UNKNOWN for a mode without a FlightModeName."""
    return _MODES.get((custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF), FlightModeName.UNKNOWN)


def mode_numbers(name: FlightModeName) -> tuple[int, int]:
    """Main and sub mode as MAV_CMD_DO_SET_MODE takes them; raises KeyError for UNKNOWN."""
    return _NUMBERS[name]


_KEPT: Final[dict[int, tuple[int, ...]]] = {
    mavlink.MAV_CMD_NAV_WAYPOINT: (0, 1, 3),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: (2, 3),
    mavlink.MAV_CMD_NAV_LOITER_TIME: (0, 1, 2, 3),
    mavlink.MAV_CMD_NAV_LAND: (1, 3),
    mavlink.MAV_CMD_NAV_TAKEOFF: (3,),
    mavlink.MAV_CMD_NAV_LOITER_TO_ALT: (0, 1, 3),
    mavlink.MAV_CMD_NAV_VTOL_TAKEOFF: (3,),
    mavlink.MAV_CMD_NAV_VTOL_LAND: (3,),
    mavlink.MAV_CMD_DO_SET_ROI_LOCATION: (),
    mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT: (),
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: (0,),
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: (0,),
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: (0,),
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: (0,),
    mavlink.MAV_CMD_NAV_RALLY_POINT: (),
}
"""The parameters, from 0, that PX4 keeps of items with a position."""
_FLAGS: Final = {mavlink.MAV_CMD_NAV_LOITER_TIME: (1, 3), mavlink.MAV_CMD_NAV_LOITER_TO_ALT: (0, 3)}
"""The parameters of which PX4 only keeps whether they are above 0."""
_HEADED: Final = frozenset(command for command, kept in _KEPT.items() if 3 in kept and command not in _FLAGS)


_VOLATILE: Final = re.compile(
    r"CAL_(ACC|GYRO|MAG)\d_[XYZ](OFF|SCALE|ODIAG|COMP)|CAL_BARO\d_OFF|SENS_DPRES_OFF|EKF2_MAG_DECL"
    r"|LND_FLIGHT_T_(HI|LO)|COM_FLIGHT_UUID|COM_MODE\d_HASH"
)
"""The parameters that PX4's own hash leaves out (`@volatile`), of 1.15 and main."""


class Px4(Autopilot):
    """A PX4 multicopter."""

    name = "PX4"
    max_speed: ClassVar = {"MPC_XY_VEL_MAX": 1.0}
    cruise_speed: ClassVar = {"MPC_XY_CRUISE": 1.0}
    hold_mode = FlightModeName.HOLD
    offboard_mode = FlightModeName.OFFBOARD
    ready_mode = FlightModeName.HOLD
    stays_armed_in: ClassVar = frozenset(
        {
            FlightModeName.MANUAL,
            FlightModeName.ALTITUDE,
            FlightModeName.POSITION,
            FlightModeName.ACRO,
            FlightModeName.STABILIZED,
            FlightModeName.HOLD,
        }
    )
    """In TAKEOFF or MISSION it flies off."""
    goto_frame = mavlink.MAV_FRAME_GLOBAL_INT
    """Some builds between PX4 1.16 and 1.17 refuse MAV_FRAME_GLOBAL."""
    is_offboard_alone = True
    priming = 10
    refuses_as_failed = False
    explains_afterwards = True
    bytewise = True
    answers_twice: ClassVar = frozenset({mavlink.MAV_CMD_DO_SET_MODE})

    def flight_mode(self, heartbeat: Any) -> FlightModeName:
        return mode_name(heartbeat.custom_mode)

    def health(self, status: Any) -> Health:
        """PX4 shows that it would arm by the health bit of PREARM_CHECK alone, which is neither present nor enabled."""
        enabled = status.onboard_control_sensors_present & status.onboard_control_sensors_enabled
        unhealthy = enabled & ~status.onboard_control_sensors_health & 0xFFFFFFFF
        return Health(bool(status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK), unhealthy)

    def hash_check(self, parameters: ParameterSet) -> int | None:
        """A CRC-32 over names and values, except those that PX4 itself changes, without the usual inversions."""
        crc = 0
        for one in parameters:
            if not _VOLATILE.fullmatch(one.name):
                value = math.nan if one.value is None else one.value
                packed = struct.pack("<f", value) if one.type.span is None else struct.pack("<q", value)[:4]
                crc = zlib.crc32(one.name.encode() + packed, crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF
        return crc

    def set_mode(self, vehicle: Vehicle, name: FlightModeName) -> Any:
        custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        return command_long(vehicle, mavlink.MAV_CMD_DO_SET_MODE, custom, *map(float, mode_numbers(name)))

    def _takeoff(self, command: Takeoff, vehicle: Vehicle, now_ms: int) -> CommandPlan:
        home_m = home_altitude_m(vehicle)
        target_m = home_m + command.altitude_m
        return CommandPlan(
            command_long(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF, *[NAN] * 6, target_m),
            mavlink.MAV_CMD_NAV_TAKEOFF,
            Group.MOTION,
            climbed(command, home_m),
            modes=frozenset({FlightModeName.TAKEOFF}),
            passing=frozenset({FlightModeName.HOLD}),
            near=above(target_m - max(ALTITUDE_NEAR_M, 0.1 * command.altitude_m)),
        )

    def _mission(self, vehicle: Vehicle) -> CommandPlan:
        return self._mode(vehicle, FlightModeName.MISSION, never)

    def _landing(self, plan: CommandPlan) -> CommandPlan:
        """PX4 enters hold when it disarms after a landing, maybe before the landed state shows it (COM_DISARM_LAND)."""
        return replace(plan, passing=frozenset({FlightModeName.HOLD}), near=is_disarmed)

    def kept(self, item: PlanItem) -> PlanItem:
        """The parameters that PX4 uses of items with a position (mavlink_mission.cpp), headings from 0 to 360°."""
        if item.command not in _KEPT or item.frame == mavlink.MAV_FRAME_MISSION:
            return item
        params: list[float | None] = [0.0] * 4
        for place in _KEPT[item.command]:
            value = item.params[place]
            if place in _FLAGS.get(item.command, ()):
                value = float(value is not None and value > 0)
            elif place == 3 and value is not None and item.command in _HEADED:
                value = value % 360
            params[place] = value
        return replace(item, params=tuple(params))

    def has_ended(self, vehicle: Vehicle, after: int) -> bool:
        return vehicle.seen(FlightMode, after) == FlightMode(self.hold_mode)

    def _hold(self, vehicle: Vehicle, now_ms: int) -> CommandPlan:
        """In the air, DO_REPOSITION to the current position: PX4 flies a goto in HOLD, which DO_SET_MODE does not stop.

        The same while armed without a fresh landed state: in recordings it did not lift a drone off the ground.
        """
        modes = frozenset({FlightModeName.HOLD})
        if vehicle.seen(Armed) != Armed(True) or landed_state(vehicle, now_ms) is Landed.ON_GROUND:
            return self._mode(vehicle, FlightModeName.HOLD, holds)
        change_mode = float(mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
        message = command_long(vehicle, mavlink.MAV_CMD_DO_REPOSITION, -1.0, change_mode, 0.0, NAN, NAN, NAN, NAN)
        return CommandPlan(message, mavlink.MAV_CMD_DO_REPOSITION, Group.MOTION, holds, modes)
