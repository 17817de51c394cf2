"""How ArduCopter carries out commands and set-points, and how it answers: its rules, results and reasons."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from ..answers import ACCEPTED, DENIED, FAILED, FORCE, UNSUPPORTED, acknowledgement, received, whole
from ..outputs import Output, Reply
from ..plans import ABOVE_HOME, ABOVE_SEA
from ..setpoints import SetPoint, of_attitude_target, of_position_target
from .autopilot import ArduCopter
from .modes import ROOTED, Mode

FORCE_ARMING = 2989.0
"""param2 of MAV_CMD_COMPONENT_ARM_DISARM that arms despite failed checks."""
_WARNING = int(mavlink.MAV_SEVERITY_WARNING)


def handle(autopilot: ArduCopter, message: Any) -> list[Output]:
    """Carry out a command, a mode change or a set-point that is for this system; other messages have no answer."""
    kind = message.get_type()
    if kind in ("COMMAND_LONG", "COMMAND_INT"):
        result = _COMMANDS.get(message.command, _unsupported)(autopilot, message)
        return [received(message), Reply(acknowledgement(message, result)), *autopilot.take_out()]
    if kind == "SET_MODE":
        _set_mode(autopilot, message.custom_mode)
    elif kind == "SET_POSITION_TARGET_LOCAL_NED":
        _follow(autopilot, of_position_target(message, autopilot.now_s, autopilot.motion.yaw_rad))
    elif kind == "SET_ATTITUDE_TARGET":
        _follow(autopilot, of_attitude_target(message, autopilot.now_s))
    return autopilot.take_out()


def _unsupported(autopilot: ArduCopter, message: Any) -> int:
    return UNSUPPORTED


def _arm_disarm(autopilot: ArduCopter, message: Any) -> int:
    if message.param1 == 1:
        why = None if autopilot.armed or message.param2 == FORCE_ARMING else autopilot.arm_refusal()
        if why is not None:
            autopilot.say(why)
            return FAILED
        autopilot.arm()
        return ACCEPTED
    if message.param1 != 0:
        return UNSUPPORTED
    if autopilot.armed and not autopilot.landed and message.param2 != FORCE:
        return FAILED
    autopilot.disarm()
    return ACCEPTED


def _takeoff(autopilot: ArduCopter, message: Any) -> int:
    """Take off to a height above home, while armed on the ground; only GUIDED flies it."""
    z = float(message.z if message.get_type() == "COMMAND_INT" else message.param7)
    if message.get_type() == "COMMAND_INT" and message.frame not in ABOVE_HOME:
        return DENIED
    up_m = autopilot.guidance.home_up_m + z
    can = autopilot.mode is Mode.GUIDED or autopilot.mode in ROOTED
    if (
        not can
        or not autopilot.armed
        or not autopilot.landed
        or not math.isfinite(z)
        or up_m <= autopilot.motion.position[2]
    ):
        return FAILED
    if autopilot.mode is Mode.GUIDED:
        autopilot.take_off(up_m)
    else:
        autopilot.speed_up()
    return ACCEPTED


def _reposition(autopilot: ArduCopter, message: Any) -> int:
    """Fly to a place in GUIDED, or after a change into it; on the ground the drone does not move."""
    changes_mode = bool((whole(message.param2) or 0) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
    if autopilot.mode is not Mode.GUIDED and not changes_mode:
        return DENIED
    target = _target(autopilot, message)
    if target is None:
        return DENIED
    autopilot.enter(Mode.GUIDED)
    autopilot.go(target)
    return ACCEPTED


def _target(autopilot: ArduCopter, message: Any) -> tuple[float, float, float] | None:
    """A command's place; None if it is invalid. COMMAND_LONG's altitude is above home."""
    guidance = autopilot.guidance
    if message.get_type() == "COMMAND_INT":
        latitude, longitude, z, frame = message.x / 1e7, message.y / 1e7, message.z, message.frame
    else:
        latitude, longitude, z, frame = message.param5, message.param6, message.param7, ABOVE_HOME[0]
    is_place = abs(latitude) <= 90 and abs(longitude) <= 180 and (latitude, longitude) != (0, 0)
    if not is_place or not math.isfinite(z) or frame not in (*ABOVE_HOME, *ABOVE_SEA):
        return None
    up_m = guidance.home_up_m + z if frame in ABOVE_HOME else z - guidance.origin.altitude_m
    return (*guidance.origin.metres_to(latitude, longitude), up_m)


def _do_set_mode(autopilot: ArduCopter, message: Any) -> int:
    flags, mode = whole(message.param1), whole(message.param2)
    if flags is None or mode is None or not flags & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return DENIED
    return _set_mode(autopilot, mode)


def _set_mode(autopilot: ArduCopter, number: int) -> int:
    try:
        mode = Mode(number)
    except ValueError:
        autopilot.say(f"No such mode {number}", _WARNING)
        return FAILED
    why = autopilot.mode_refusal(mode)
    if why is not None:
        autopilot.say(f"Mode change to {mode.name} failed: {why}", _WARNING)
        return FAILED
    autopilot.enter(mode)
    return ACCEPTED


def _into(mode: Mode) -> Callable[[ArduCopter, Any], int]:
    """Make the handler of a command that enters a mode."""
    return lambda autopilot, message: _set_mode(autopilot, mode.custom_mode)


def _start_mission(autopilot: ArduCopter, message: Any) -> int:
    """Enter AUTO; if armed, begin or continue the mission there."""
    result = _set_mode(autopilot, Mode.AUTO.custom_mode)
    if result == ACCEPTED and autopilot.armed:
        autopilot.start_mission()
    return result


def _follow(autopilot: ArduCopter, point: SetPoint | None) -> None:
    """Follow a set-point, in GUIDED in the air. A position is flown to without further set-points."""
    if point is None or autopilot.mode is not Mode.GUIDED or autopilot.landed:
        return
    if point.position is not None:
        autopilot.go(point.position)
    else:
        autopilot.follow(point)


def _nothing_to_do(autopilot: ArduCopter, message: Any) -> int:
    """Accepted without any effect in the stand-in."""
    return ACCEPTED


def _nothing_there(autopilot: ArduCopter, message: Any) -> int:
    """Fail a command for a camera, gimbal or servo: the stand-in has none."""
    return FAILED


def _change_speed(autopilot: ArduCopter, message: Any) -> int:
    """A speed above 0 is accepted, without any effect in the stand-in."""
    return ACCEPTED if message.param2 > 0 else FAILED


_COMMANDS: dict[int, Callable[[ArduCopter, Any], int]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    mavlink.MAV_CMD_NAV_TAKEOFF: _takeoff,
    mavlink.MAV_CMD_NAV_LAND: _into(Mode.LAND),
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: _into(Mode.RTL),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: _into(Mode.LOITER),
    mavlink.MAV_CMD_DO_REPOSITION: _reposition,
    mavlink.MAV_CMD_DO_SET_MODE: _do_set_mode,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: _change_speed,
    mavlink.MAV_CMD_MISSION_START: _start_mission,
    **dict.fromkeys(
        (
            mavlink.MAV_CMD_DO_DIGICAM_CONTROL,
            mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
            mavlink.MAV_CMD_DO_SET_ROI_LOCATION,
            mavlink.MAV_CMD_CONDITION_YAW,
        ),
        _nothing_to_do,
    ),
    **dict.fromkeys(
        (
            mavlink.MAV_CMD_DO_MOUNT_CONFIGURE,
            mavlink.MAV_CMD_DO_MOUNT_CONTROL,
            mavlink.MAV_CMD_IMAGE_START_CAPTURE,
            mavlink.MAV_CMD_DO_SET_SERVO,
        ),
        _nothing_there,
    ),
}
