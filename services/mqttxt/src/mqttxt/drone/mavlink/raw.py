"""MAV_CMDs that have no form of their own: sent as they are, within limits (docs/protocol.md, section 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

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
from .plans import AUTOPILOT_COMPONENT, NAN, CannotExecute, Plan, never
from .vehicle import Vehicle

MAV_CMDS: dict[int, str] = {
    number: entry.name for number, entry in mavlink.enums["MAV_CMD"].items() if not entry.name.endswith("_ENUM_END")
}
"""Every MAV_CMD of common.xml by its number."""

TYPED: dict[int, str] = {
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: Return.name,
    mavlink.MAV_CMD_NAV_LAND: Land.name,
    mavlink.MAV_CMD_NAV_TAKEOFF: Takeoff.name,
    mavlink.MAV_CMD_NAV_GUIDED_ENABLE: Offboard.name,
    mavlink.MAV_CMD_DO_SET_MODE: Hold.name,
    mavlink.MAV_CMD_DO_REPOSITION: Goto.name,
    mavlink.MAV_CMD_DO_PAUSE_CONTINUE: Pause.name,
    mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: SetCurrentItem.name,
    mavlink.MAV_CMD_MISSION_START: StartMission.name,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: Arm.name,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: Stream.name,
}
"""What has a form of its own, with deadline, proof of effect and order among its likes."""

GUARDED: dict[int, str] = {
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
}
"""What is denied unless an option of the UAV client allows it, and why."""


@dataclass(frozen=True)
class Limits:
    """What a UAV client lets pass: guarded MAV_CMDs and parameters, and components beside the autopilot.

    `ranges` are the least and the greatest value of the parameters whose range is known.
    """

    mav_cmds: frozenset[int] = frozenset()
    components: frozenset[int] = frozenset()
    parameters: frozenset[str] = frozenset()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def plan_raw(command: Mavlink, vehicle: Vehicle, limits: Limits) -> Plan:
    """The plan of a MAV_CMD as it is; raises CannotExecute where it is not to be sent."""
    number = command.mav_cmd
    if number not in MAV_CMDS:
        raise CannotExecute("unknown_mav_cmd")
    is_forced = number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and bool(command.params[1])
    if number in TYPED and not is_forced:
        raise CannotExecute(f"use_typed_command, {_typed(command)}")
    if number in GUARDED and number not in limits.mav_cmds:
        raise CannotExecute("mav_cmd_not_enabled")
    component = command.component or AUTOPILOT_COMPONENT
    if component != AUTOPILOT_COMPONENT and component not in limits.components:
        raise CannotExecute("component_not_enabled")
    params: list[Any] = [NAN if param is None else param for param in command.params]
    message = mavlink.MAVLink_command_long_message(vehicle.system_id, component, number, 0, *params)
    return Plan(message, number, None, never, is_said_once=True)


def _typed(command: Mavlink) -> str:
    is_disarm = command.mav_cmd == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and not command.params[0]
    return Disarm.name if is_disarm else TYPED[command.mav_cmd]
