"""MAV_CMDs without a command of their own: sent unchanged, within limits (docs/protocol.md, section 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.commands import (
    Arm,
    Disarm,
    Goto,
    Hold,
    Land,
    Mavlink,
    Offboard,
    Pause,
    Return,
    SetCurrentItem,
    StartMission,
    Stream,
    Takeoff,
)
from .plans import AUTOPILOT_COMPONENT, NAN, CannotExecute, CommandPlan, never
from .vehicle import Vehicle

MAV_CMDS: dict[int, str] = {
    number: entry.name for number, entry in mavlink.enums["MAV_CMD"].items() if not entry.name.endswith("_ENUM_END")
}
"""Every MAV_CMD of common.xml by its number."""

TYPED: dict[int, str] = {
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: Hold.name,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: Return.name,
    mavlink.MAV_CMD_NAV_LAND: Land.name,
    mavlink.MAV_CMD_NAV_TAKEOFF: Takeoff.name,
    mavlink.MAV_CMD_NAV_LAND_LOCAL: Land.name,
    mavlink.MAV_CMD_NAV_TAKEOFF_LOCAL: Takeoff.name,
    mavlink.MAV_CMD_NAV_VTOL_TAKEOFF: Takeoff.name,
    mavlink.MAV_CMD_NAV_VTOL_LAND: Land.name,
    mavlink.MAV_CMD_NAV_GUIDED_ENABLE: Offboard.name,
    mavlink.MAV_CMD_DO_SET_MODE: Hold.name,
    mavlink.MAV_CMD_DO_REPOSITION: Goto.name,
    mavlink.MAV_CMD_DO_PAUSE_CONTINUE: Pause.name,
    mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: SetCurrentItem.name,
    mavlink.MAV_CMD_OVERRIDE_GOTO: Pause.name,
    mavlink.MAV_CMD_DO_SET_STANDARD_MODE: Hold.name,
    mavlink.MAV_CMD_MISSION_START: StartMission.name,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: Arm.name,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: Stream.name,
}
"""MAV_CMDs with a command of their own, which has a deadline, proof of effect and order in its group."""

_NUMBERS: Final[dict[str, int]] = {name.removeprefix("MAV_CMD_"): number for number, name in MAV_CMDS.items()}


def _numbers(*names: str) -> frozenset[int]:
    """The MAV_CMDs with these names, without the prefix."""
    return frozenset(_NUMBERS[name] for line in names for name in line.split())


_FLYING: Final = _numbers(
    "DO_FOLLOW DO_FOLLOW_REPOSITION DO_ORBIT DO_FIGURE_EIGHT DO_CHANGE_ALTITUDE DO_RETURN_PATH_START DO_LAND_START",
    "DO_RALLY_LAND DO_GO_AROUND DO_SET_REVERSE DO_INVERTED_FLIGHT DO_AUTOTUNE_ENABLE DO_VTOL_TRANSITION",
    "NAV_SET_YAW_SPEED SET_GUIDED_SUBMODE_STANDARD SET_GUIDED_SUBMODE_CIRCLE GUIDED_CHANGE_ALTITUDE",
    "GUIDED_CHANGE_HEADING PAYLOAD_PREPARE_DEPLOY",
)
_ITEMS: Final = _numbers(
    "NAV_WAYPOINT NAV_LOITER_TURNS NAV_LOITER_TIME NAV_FOLLOW NAV_CONTINUE_AND_CHANGE_ALT NAV_LOITER_TO_ALT",
    "NAV_ARC_WAYPOINT NAV_PATHPLANNING NAV_SPLINE_WAYPOINT NAV_DELAY NAV_PAYLOAD_PLACE NAV_LAST CONDITION_DELAY",
    "CONDITION_CHANGE_ALT CONDITION_DISTANCE CONDITION_LAST CONDITION_GATE DO_JUMP DO_LAST JUMP_TAG DO_JUMP_TAG",
    "NAV_FENCE_RETURN_POINT NAV_FENCE_POLYGON_VERTEX_INCLUSION NAV_FENCE_POLYGON_VERTEX_EXCLUSION",
    "NAV_FENCE_CIRCLE_INCLUSION NAV_FENCE_CIRCLE_EXCLUSION NAV_RALLY_POINT",
)
_OF_A_BUILD: Final = _numbers(
    "WAYPOINT_USER_1 WAYPOINT_USER_2 WAYPOINT_USER_3 WAYPOINT_USER_4 WAYPOINT_USER_5",
    "SPATIAL_USER_1 SPATIAL_USER_2 SPATIAL_USER_3 SPATIAL_USER_4 SPATIAL_USER_5",
    "USER_1 USER_2 USER_3 USER_4 USER_5",
)

GUARDED: dict[int, str] = {
    **dict.fromkeys(_FLYING, "flies the drone otherwise than its commands do"),
    **dict.fromkeys(_ITEMS, "an item of a plan"),
    **dict.fromkeys(_OF_A_BUILD, "is what the autopilot's builder made of it"),
    mavlink.MAV_CMD_DO_SET_PARAMETER: "sets any parameter, ids among them",
    mavlink.MAV_CMD_DO_FLIGHTTERMINATION: "ends the flight by falling",
    mavlink.MAV_CMD_DO_FENCE_ENABLE: "may switch the geofence off",
    mavlink.MAV_CMD_DO_PARACHUTE: "ends the flight",
    mavlink.MAV_CMD_DO_MOTOR_TEST: "turns motors",
    mavlink.MAV_CMD_DO_GUIDED_MASTER: "gives control to another system id",
    mavlink.MAV_CMD_PREFLIGHT_CALIBRATION: "overwrites calibrations",
    mavlink.MAV_CMD_PREFLIGHT_SET_SENSOR_OFFSETS: "overwrites calibrations",
    mavlink.MAV_CMD_PREFLIGHT_UAVCAN: "changes CAN ids",
    mavlink.MAV_CMD_PREFLIGHT_STORAGE: "writes or resets all parameters",
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: "stops the autopilot",
    mavlink.MAV_CMD_ACTUATOR_TEST: "turns motors",
    mavlink.MAV_CMD_CONFIGURE_ACTUATOR: "changes motors' order",
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: "forced; without force there is a form of its own",
    mavlink.MAV_CMD_INJECT_FAILURE: "breaks a sensor or a motor",
    mavlink.MAV_CMD_START_RX_PAIR: "parts the pilot's remote control from the drone",
    mavlink.MAV_CMD_STORAGE_FORMAT: "erases the log",
    mavlink.MAV_CMD_CONTROL_HIGH_LATENCY: "silences the autopilot",
    mavlink.MAV_CMD_CAN_FORWARD: "opens the CAN bus",
    mavlink.MAV_CMD_FIXED_MAG_CAL_YAW: "overwrites calibrations",
    mavlink.MAV_CMD_DO_ENGINE_CONTROL: "starts or stops engines",
    mavlink.MAV_CMD_ARM_AUTHORIZATION_REQUEST: "may let the autopilot arm",
    mavlink.MAV_CMD_DO_SET_SAFETY_SWITCH_STATE: "lets motors turn, or stops them",
    mavlink.MAV_CMD_EXTERNAL_POSITION_ESTIMATE: "gives the autopilot another position",
}
"""MAV_CMDs that only an option of the UAV client allows, with the reasons."""

PASSED: Final = _numbers(
    "CONDITION_YAW DO_CHANGE_SPEED GUIDED_CHANGE_SPEED DO_GUIDED_LIMITS DO_SET_HOME GET_HOME_POSITION",
    "NAV_ROI DO_SET_ROI DO_SET_ROI_LOCATION DO_SET_ROI_WPNEXT_OFFSET DO_SET_ROI_NONE DO_SET_ROI_SYSID",
    "DO_SET_RELAY DO_REPEAT_RELAY DO_SET_SERVO DO_REPEAT_SERVO DO_SET_ACTUATOR DO_GRIPPER DO_WINCH",
    "PAYLOAD_CONTROL_DEPLOY AIRFRAME_CONFIGURATION ILLUMINATOR_ON_OFF DO_ILLUMINATOR_CONFIGURE DO_ADSB_OUT_IDENT",
    "DO_CONTROL_VIDEO DO_DIGICAM_CONFIGURE DO_DIGICAM_CONTROL DO_MOUNT_CONFIGURE DO_MOUNT_CONTROL",
    "DO_MOUNT_CONTROL_QUAT DO_SET_CAM_TRIGG_DIST DO_SET_CAM_TRIGG_INTERVAL DO_TRIGGER_CONTROL OBLIQUE_SURVEY",
    "DO_GIMBAL_MANAGER_PITCHYAW DO_GIMBAL_MANAGER_CONFIGURE IMAGE_START_CAPTURE IMAGE_STOP_CAPTURE",
    "CAMERA_TRACK_POINT CAMERA_TRACK_RECTANGLE CAMERA_STOP_TRACKING VIDEO_START_CAPTURE VIDEO_STOP_CAPTURE",
    "VIDEO_START_STREAMING VIDEO_STOP_STREAMING PANORAMA_CREATE SET_CAMERA_MODE SET_CAMERA_ZOOM SET_CAMERA_FOCUS",
    "SET_CAMERA_SOURCE RESET_CAMERA_SETTINGS SET_STORAGE_USAGE LOGGING_START LOGGING_STOP RUN_PREARM_CHECKS",
    "GET_MESSAGE_INTERVAL REQUEST_MESSAGE REQUEST_PROTOCOL_VERSION REQUEST_AUTOPILOT_CAPABILITIES",
    "REQUEST_CAMERA_INFORMATION REQUEST_CAMERA_SETTINGS REQUEST_STORAGE_INFORMATION REQUEST_CAMERA_CAPTURE_STATUS",
    "REQUEST_FLIGHT_INFORMATION REQUEST_CAMERA_IMAGE_CAPTURE REQUEST_VIDEO_STREAM_INFORMATION",
    "REQUEST_VIDEO_STREAM_STATUS UAVCAN_GET_NODE_INFO",
)
"""MAV_CMDs that are sent unchanged: they neither arm, take off, change the mode nor fly the drone elsewhere."""


@dataclass(frozen=True)
class Limits:
    """The guarded MAV_CMDs and parameters that a UAV client allows, and the components besides the autopilot.

    `ranges` has the least and the greatest value of each parameter whose range is known.
    """

    mav_cmds: frozenset[int] = frozenset()
    components: frozenset[int] = frozenset()
    parameters: frozenset[str] = frozenset()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def range_of(self, name: str) -> tuple[float, float] | None:
        """A parameter's range if it is known. ArduPilot ignores the case of names."""
        return self.ranges.get(name, self.ranges.get(name.upper()))


def plan_raw(command: Mavlink, vehicle: Vehicle, limits: Limits) -> CommandPlan:
    """The plan of an unchanged MAV_CMD. Raises CannotExecute if it must not be sent."""
    number = command.mav_cmd
    if number not in MAV_CMDS:
        raise CannotExecute("unknown_mav_cmd")
    is_forced = number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and bool(command.params[1])
    if number in TYPED and not is_forced:
        raise CannotExecute(f"use_typed_command, {_typed(command)}")
    if number not in PASSED and number not in limits.mav_cmds:
        raise CannotExecute("mav_cmd_not_enabled")
    component = command.component or AUTOPILOT_COMPONENT
    if component != AUTOPILOT_COMPONENT and component not in limits.components:
        raise CannotExecute("component_not_enabled")
    if None in command.params and component == AUTOPILOT_COMPONENT and vehicle.autopilot.ends_on_nan:
        raise CannotExecute("null_param")
    params: list[Any] = [NAN if param is None else param for param in command.params]
    message = mavlink.MAVLink_command_long_message(vehicle.system_id, component, number, 0, *params)
    return CommandPlan(message, number, None, never, is_said_once=True)


def _typed(command: Mavlink) -> str:
    is_disarm = command.mav_cmd == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and not command.params[0]
    return Disarm.name if is_disarm else TYPED[command.mav_cmd]
