"""How PX4 carries out commands and set-points, and how it answers: its rules, results and reasons."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from ..answers import ACCEPTED, DENIED, FORCE, REJECTED, UNSUPPORTED, acknowledgement, received, whole
from ..outputs import Output, Reply
from ..plans import ABOVE_HOME, ABOVE_SEA
from ..setpoints import SetPoint, of_attitude_target, of_position_target
from .autopilot import Px4
from .modes import Mode

_CURRENT = 0x7FFFFFFF
"""COMMAND_INT's x or y that stands for the current position."""


def handle(autopilot: Px4, message: Any) -> list[Output]:
    """Carry out a command, a mode change or a set-point that is for this system; other messages have no answer."""
    kind = message.get_type()
    if kind in ("COMMAND_LONG", "COMMAND_INT"):
        results = _results(autopilot, message)
        answers = [Reply(acknowledgement(message, result)) for result in results]
        return [received(message), *answers, *autopilot.take_out()]
    if kind == "SET_MODE":
        _set_mode(autopilot, message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24 & 0xFF)
    elif kind == "SET_POSITION_TARGET_LOCAL_NED":
        _take(autopilot, of_position_target(message, autopilot.now_s, autopilot.motion.yaw_rad))
    elif kind == "SET_ATTITUDE_TARGET":
        _take(autopilot, of_attitude_target(message, autopilot.now_s))
    return autopilot.take_out()


def _results(autopilot: Px4, message: Any) -> list[int]:
    """The results in the order of their acknowledgements; none for a command that PX4 leaves unanswered."""
    if message.command in _UNANSWERED or _is_no_arming(message):
        return []
    if message.command in _NOTHING_TO_DO:
        return [ACCEPTED]
    result = _COMMANDS.get(message.command, _unsupported)(autopilot, message)
    # PX4 acknowledges that it has received a mode change, and then its result.
    return [ACCEPTED, result] if message.command == mavlink.MAV_CMD_DO_SET_MODE else [result]


def _refuse(autopilot: Px4, why: str, result: int = REJECTED) -> int:
    autopilot.say(why)
    return result


def _unsupported(autopilot: Px4, message: Any) -> int:
    return UNSUPPORTED


def _arm_disarm(autopilot: Px4, message: Any) -> int:
    forced = message.param2 == FORCE
    if _rounded(message.param1) == 1:
        reason = None if autopilot.armed or forced else autopilot.arm_refusal()
        if reason is not None:
            return _refuse(autopilot, reason)
        autopilot.arm()
    else:
        if autopilot.armed and not autopilot.landed and not forced:
            return _refuse(autopilot, "Disarming denied: not landed")
        autopilot.disarm()
    return ACCEPTED


def _rounded(param: float) -> int | None:
    return whole(param + 0.5) if math.isfinite(param) and param > -0.5 else None


def _is_no_arming(message: Any) -> bool:
    """Whether a command arms by a number other than 0 and 1, which PX4 leaves unanswered."""
    return message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and _rounded(message.param1) not in (0, 1)


def _takeoff(autopilot: Px4, message: Any) -> int:
    """Accepted whether armed or not; disarmed, the mode stays and the next arming starts the climb."""
    z = _z(message)
    if math.isinf(z):
        return _refuse(autopilot, "Takeoff denied: altitude is not a number", DENIED)
    _take_off_to(autopilot, None if math.isnan(z) else _up(autopilot, message, z))
    return ACCEPTED


def _take_off_to(autopilot: Px4, up_m: float | None) -> None:
    """Take off to a height above the origin, never downwards; without one to MIS_TAKEOFF_ALT above home."""
    guidance = autopilot.guidance
    north, east, here = guidance.motion.position
    if up_m is None:
        up_m = guidance.home_up_m + autopilot.parameters["MIS_TAKEOFF_ALT"]
    if up_m < here:
        autopilot.say("Already higher than takeoff altitude")
    guidance.target = (north, east, max(up_m, here))
    autopilot.enter(Mode.TAKEOFF)


def _land(autopilot: Px4, message: Any) -> int:
    autopilot.enter(Mode.LAND)
    return ACCEPTED


def _reposition(autopilot: Px4, message: Any) -> int:
    """Accepted anywhere. Disarmed, it does nothing; armed on the ground, it takes off; without x, y, z, it stops."""
    guidance = autopilot.guidance
    z = _z(message)
    place = _horizontal(autopilot, message)
    if (
        place is None
        or math.isinf(z)
        or (message.get_type() == "COMMAND_INT" and message.frame not in (*ABOVE_SEA, *ABOVE_HOME))
    ):
        return _refuse(autopilot, "Reposition rejected: position is not valid", DENIED)
    changes_mode = bool((whole(message.param2) or 0) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
    if autopilot.mode is not Mode.HOLD and not changes_mode:
        return _refuse(autopilot, "Reposition rejected: not in hold")
    autopilot.enter(Mode.HOLD)
    if not autopilot.armed:
        return ACCEPTED
    if _leaves_out_the_place(message):
        guidance.stop_here()
        if not math.isnan(z):
            guidance.target = (*guidance.target[:2], max(0.0, _up(autopilot, message, z)))
        return ACCEPTED
    up = guidance.motion.position[2] if math.isnan(z) else max(0.0, _up(autopilot, message, z))
    guidance.go((*guidance.origin.metres_to(*place), up), autopilot.now_s)
    return ACCEPTED


def _leaves_out_the_place(message: Any) -> bool:
    if message.get_type() == "COMMAND_INT":
        return bool(message.x == _CURRENT and message.y == _CURRENT)
    return math.isnan(message.param5) and math.isnan(message.param6)


def _horizontal(autopilot: Px4, message: Any) -> tuple[float, float] | None:
    """Latitude and longitude in degrees, the drone's own if the command leaves one out; None if invalid."""
    here = autopilot.guidance.place
    if message.get_type() == "COMMAND_INT":
        wanted = [math.nan if value == _CURRENT else value / 1e7 for value in (message.x, message.y)]
    else:
        wanted = [message.param5, message.param6]
    latitude = here.latitude_deg if math.isnan(wanted[0]) else wanted[0]
    longitude = here.longitude_deg if math.isnan(wanted[1]) else wanted[1]
    return (latitude, longitude) if abs(latitude) <= 90 and abs(longitude) <= 180 else None


def _do_set_mode(autopilot: Px4, message: Any) -> int:
    flags, main, sub = (whole(value) for value in (message.param1, message.param2, message.param3))
    if flags is None or not flags & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return _refuse(autopilot, "Mode change denied: custom mode expected")
    return _set_mode(autopilot, main or 0, sub or 0)


def _set_mode(autopilot: Px4, main: int, sub: int) -> int:
    """Enter a mode: disarmed any, armed those in which it can fly."""
    try:
        mode = Mode((main, sub))
    except ValueError:
        return _refuse(autopilot, f"Unsupported mode {main} {sub}")
    if autopilot.armed and not autopilot.can_fly_in(mode):
        return _refuse(autopilot, f"Switching to {mode.name.title()} is currently not available")
    if mode is Mode.TAKEOFF:
        _take_off_to(autopilot, None)
    else:
        autopilot.enter(mode)
    return ACCEPTED


def _start_mission(autopilot: Px4, message: Any) -> int:
    """Enter the mission mode, and arm if disarmed."""
    first = whole(message.param1)
    if first is None or not -1 <= first < len(autopilot.plans.mission):
        return DENIED
    reason = None if autopilot.armed else autopilot.arm_refusal()
    if reason is not None:
        return _refuse(autopilot, reason)
    autopilot.arm()
    autopilot.enter(Mode.MISSION)
    return ACCEPTED


def _z(message: Any) -> float:
    return float(message.z if message.get_type() == "COMMAND_INT" else message.param7)


def _up(autopilot: Px4, message: Any, z: float) -> float:
    """A command's height above the origin; only COMMAND_INT names a frame, COMMAND_LONG's altitude is AMSL."""
    guidance = autopilot.guidance
    if message.get_type() == "COMMAND_INT" and message.frame in ABOVE_HOME:
        return guidance.home_up_m + z
    return z - guidance.origin.altitude_m


def _take(autopilot: Px4, point: SetPoint | None) -> None:
    """Take a set-point; None leaves the last one."""
    if point is not None:
        autopilot.guidance.set_point = point


_UNANSWERED = frozenset(
    {
        mavlink.MAV_CMD_DO_DIGICAM_CONTROL,
        mavlink.MAV_CMD_DO_MOUNT_CONFIGURE,
        mavlink.MAV_CMD_DO_MOUNT_CONTROL,
        mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
        mavlink.MAV_CMD_SET_CAMERA_MODE,
    }
)
"""Commands for payloads: PX4's simulation has none that answers."""
_NOTHING_TO_DO = frozenset(
    {
        mavlink.MAV_CMD_DO_SET_ROI_LOCATION,
        mavlink.MAV_CMD_DO_CHANGE_SPEED,
        mavlink.MAV_CMD_PREFLIGHT_CALIBRATION,
        mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
    }
)
"""Accepted without any effect in the stand-in."""
_COMMANDS: dict[int, Callable[[Px4, Any], int]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    mavlink.MAV_CMD_NAV_TAKEOFF: _takeoff,
    mavlink.MAV_CMD_NAV_LAND: _land,
    mavlink.MAV_CMD_DO_REPOSITION: _reposition,
    mavlink.MAV_CMD_DO_SET_MODE: _do_set_mode,
    mavlink.MAV_CMD_MISSION_START: _start_mission,
}
