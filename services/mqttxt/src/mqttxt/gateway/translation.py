"""Translates MAVLink commands into those of MQTT-XT, or declines them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ..drone.mavlink.vehicle import UNKNOWN_U16
from ..protocol.commands import (
    Arm,
    Command,
    Disarm,
    Goto,
    Hold,
    Land,
    Mavlink,
    Resume,
    Return,
    SetCurrentItem,
    StartMission,
    Stream,
    Takeoff,
)
from ..protocol.mavlink_states import kinds
from ..protocol.states import Airframe, FlightModeName, Home, Location, Mission, VelocityNed
from ..protocol.topics import MAVLINK_STATE
from .modes import ARDUPILOT, command_for, commandable, mode_of, mode_of_command
from .telemetry import UNKNOWN_AUTOPILOT, View

DENIED, UNSUPPORTED = int(mavlink.MAV_RESULT_DENIED), int(mavlink.MAV_RESULT_UNSUPPORTED)
NOT_NOW = int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
CANCELLED = 6
"""MAV_RESULT_CANCELLED, which pymavlink's common dialect does not have."""
REQUEST_OPERATOR_CONTROL = 32100
"""MAV_CMD_REQUEST_OPERATOR_CONTROL, which pymavlink's common dialect does not have."""
_PAUSE, _CONTINUE = 0, 1
_INT32_MAX = 2**31 - 1
_ABOVE_SEA: Final = frozenset({mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT})
_ABOVE_HOME: Final = frozenset({mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})
_OF_PROTOCOLS: Final = (
    "AUTH_", "CHANGE_OPERATOR_", "COMMAND_", "FILE_", "LOG", "MANUAL_", "MISSION_", "PARAM_",
    "PING", "RC_CHANNELS_OVERRIDE", "REQUEST_", "SET", "TIMESYNC",
)  # fmt: skip


class Declined(Exception):
    """A command that is not sent, with its `result` for COMMAND_ACK; the message is for people."""

    def __init__(self, text: str, result: int = DENIED) -> None:
        super().__init__(text)
        self.result = result


@dataclass(frozen=True)
class Request:
    """A command as a client sent it. `params` are seven, None where not set; `frame` is None for a COMMAND_LONG.

    `is_message`: it arrived as a message of its own, which no COMMAND_ACK answers. `is_whole_mode`: it names a mode by
    HEARTBEAT's custom_mode, as SET_MODE does; DO_SET_MODE has that of a PX4 in two parameters.
    """

    mav_cmd: int
    params: tuple[float | None, ...]
    frame: int | None = None
    is_message: bool = False
    is_whole_mode: bool = False

    @classmethod
    def of(cls, message: Any) -> Request:
        """The request in a COMMAND_LONG, a COMMAND_INT, a SET_MODE or a MISSION_SET_CURRENT."""
        kind = message.get_type()
        if kind == "MISSION_SET_CURRENT":
            number = int(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT)
            return cls(number, (float(message.seq), *[None] * 6), is_message=True)
        if kind == "SET_MODE":
            params = (float(message.base_mode), float(message.custom_mode), *[None] * 5)
            return cls(int(mavlink.MAV_CMD_DO_SET_MODE), params, is_whole_mode=True)
        first = (message.param1, message.param2, message.param3, message.param4)
        if kind == "COMMAND_LONG":
            last = (message.param5, message.param6, message.param7)
            return cls(message.command, tuple(map(_set, (*first, *last))))
        place = (None if at == _INT32_MAX else at / 1e7 for at in (message.x, message.y))
        return cls(message.command, (*map(_set, first), *place, _set(message.z)), message.frame)

    def whole(self, number: int) -> int | None:
        """Parameter 1 to 7 as a whole number; None if it is not one."""
        value = self.params[number - 1]
        return int(value) if value is not None and math.isfinite(value) and value == int(value) else None


def _set(value: float) -> float | None:
    return None if math.isnan(value) else value


def name_of(mav_cmd: int) -> str:
    """A MAV_CMD's name without its prefix, or its number."""
    known = mavlink.enums["MAV_CMD"].get(mav_cmd)
    return str(mav_cmd) if known is None else known.name.removeprefix("MAV_CMD_")


def command_of(request: Request, view: View, takeoff_m: float) -> Command:
    """The command for a request; raises Declined. `takeoff_m`: metres above home if the request names no altitude."""
    if request.mav_cmd == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
        return _arming(request)
    if request.mav_cmd == mavlink.MAV_CMD_NAV_TAKEOFF:
        return _takeoff(request, view, takeoff_m)
    if request.mav_cmd == mavlink.MAV_CMD_NAV_LAND:
        return Land()
    if request.mav_cmd == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
        return Return()
    if request.mav_cmd == mavlink.MAV_CMD_NAV_LOITER_UNLIM:  # pymavlink's set_mode_loiter
        return Hold()
    if request.mav_cmd == mavlink.MAV_CMD_DO_REPOSITION:
        return _reposition(request, view)
    if request.mav_cmd == mavlink.MAV_CMD_DO_SET_MODE:
        return _mode(request, view)
    if request.mav_cmd == mavlink.MAV_CMD_DO_PAUSE_CONTINUE:
        return _pause_or_continue(request, view)
    if request.mav_cmd == mavlink.MAV_CMD_MISSION_START:
        item = 1 if request.params[0] is None else _item(request, view)
        return StartMission(_mission(view), item)
    if request.mav_cmd == mavlink.MAV_CMD_DO_SET_MISSION_CURRENT:
        return _set_current(request, view)
    if request.mav_cmd == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
        return _stream(request)
    return _raw(request)


def _arming(request: Request) -> Command:
    if request.params[1]:
        raise Declined("arming is never forced here")
    if request.whole(1) not in (0, 1):
        raise Declined(f"COMPONENT_ARM_DISARM {request.params[0]}: expected 1 to arm, 0 to disarm")
    return Arm() if request.whole(1) else Disarm()


def _takeoff(request: Request, view: View, takeoff_m: float) -> Command:
    altitude_m = request.params[6]
    if altitude_m is None:
        return Takeoff(takeoff_m)
    is_ardupilots = request.frame is None and _autopilot(view) == ARDUPILOT
    height_m = altitude_m if is_ardupilots else _height_m(request.frame, altitude_m, view)
    if height_m > 0:
        return Takeoff(height_m)
    home_m = altitude_m - height_m
    if altitude_m > 0:
        raise Declined(
            f"takeoff to {altitude_m:g} m: that is above sea level, and home is at {home_m:.1f} m; "
            f"expected {home_m + altitude_m:.1f} to fly {altitude_m:g} m above home"
        )
    raise Declined(f"takeoff to {height_m:.1f} m above home: expected more than 0")


def _reposition(request: Request, view: View) -> Command:
    """A goto; without a position a hold, which is QGroundControl's pause."""
    latitude, longitude, altitude = request.params[4:]
    if latitude is None or longitude is None:
        if altitude is not None:
            raise Declined("a change of altitude takes a position: go to a point at that altitude")
        return Hold()
    _check_frame(request.frame)
    if latitude == longitude == 0:
        raise Declined("reposition to 0, 0: expected a position, or NaN to stay")
    if altitude is not None:
        return Goto(latitude, longitude, _height_m(request.frame, altitude, view))
    location = view.get(Location)
    if location is None or not view.is_recent(Location, VelocityNed):
        raise Declined("reposition without an altitude: the drone's own is not known")
    return Goto(latitude, longitude, location.altitude_m)


def _check_frame(frame: int | None) -> None:
    """Raises Declined for a frame in which a position is not degrees, or an altitude not above sea or home."""
    if frame is not None and frame not in _ABOVE_HOME | _ABOVE_SEA:
        raise Declined(f"frame {frame}: expected a global one", UNSUPPORTED)


def _height_m(frame: int | None, altitude_m: float, view: View) -> float:
    """Metres above home; COMMAND_LONG has no frame and means metres above sea level."""
    _check_frame(frame)
    if frame in _ABOVE_HOME:
        return altitude_m
    home = view.get(Home)
    if home is None:
        raise Declined("home is not known, and so no height above it")
    return altitude_m - home.altitude_amsl_m


def _mode(request: Request, view: View) -> Command:
    autopilot = _autopilot(view)
    base, main, sub = request.whole(1), request.whole(2), request.whole(3) or 0
    if base is None or main is None or not base & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        raise Declined("DO_SET_MODE: expected a custom mode of this autopilot")
    mode = mode_of(autopilot, main) if request.is_whole_mode else mode_of_command(autopilot, main, sub)
    if mode is FlightModeName.MISSION:
        return _go_on(view)
    command = command_for(autopilot, mode)
    if command is None:
        raise Declined(f"mode {mode.name}: no command leads to it; expected {commandable(autopilot)}")
    return command


def _autopilot(view: View) -> int:
    """The kind of the drone's autopilot; raises Declined while it is not known: it is never guessed."""
    airframe = view.get(Airframe)
    if airframe is None:
        raise Declined(UNKNOWN_AUTOPILOT, NOT_NOW)
    return airframe.autopilot


def _mission(view: View) -> bytes:
    """The hash of the mission that a client means: of the one that it uploaded or read, else of the drone's own."""
    known = view.get(Mission)
    named = view.named or (None if known is None else known.mission)
    if named is None:
        raise Declined("the drone's mission is not known here: upload or read it first", NOT_NOW)
    return named


def _go_on(view: View) -> Command:
    """Resume the mission at its current item, as the mission mode does; start one that is new or over.

    A restarted UAV client does not know to which mission the current item belongs until it reads the mission for
    `resume`, which is denied if it is another one.
    """
    named, mission = _mission(view), view.get(Mission)
    if mission is not None and mission.mission is None and mission.current > 1:
        return Resume(named)
    if mission is None or mission.mission != named:
        return StartMission(named)
    if 0 < mission.total <= mission.reached:
        return StartMission(named, mission.current if 0 < mission.current < mission.total else 1)
    return Resume(named)


def _pause_or_continue(request: Request, view: View) -> Command:
    if request.whole(1) not in (_PAUSE, _CONTINUE):
        raise Declined(f"DO_PAUSE_CONTINUE {request.params[0]}: expected 0 to pause, 1 to continue")
    return Hold() if request.whole(1) == _PAUSE else _go_on(view)


def _set_current(request: Request, view: View) -> Command:
    if request.params[1]:
        raise Declined("DO_SET_MISSION_CURRENT: a mission is not reset; expected 0 in param2", UNSUPPORTED)
    item = _item(request, view)
    return SetCurrentItem(_mission(view), item)


def _item(request: Request, view: View) -> int:
    """The plan's number of the item in param1; raises Declined if that is none."""
    _autopilot(view)  # which says how its items count
    seq = request.whole(1)
    if seq is None or not 0 <= seq < UNKNOWN_U16:
        raise Declined(f"{name_of(request.mav_cmd)} {request.params[0]}: expected an item's number")
    return view.item(seq)


def is_of_protocol(name: str) -> bool:
    """Whether a message is a question, an answer or an order between two: clients take it as the gateway's own."""
    return name.startswith(_OF_PROTOCOLS)


def _stream(request: Request) -> Command:
    """SET_MESSAGE_INTERVAL of a message that only the drone has; an interval of 0 or less ends the stream."""
    number, interval_us = request.whole(1), request.params[1]
    name = next((name for name, kind in kinds().items() if kind.id == number), None)
    if name is None:
        raise Declined(f"message {request.params[0]}: not in common.xml", UNSUPPORTED)
    if is_of_protocol(name):
        raise Declined(f"message {name}: it is not streamed", UNSUPPORTED)
    return Stream(MAVLINK_STATE + name, 1e6 / interval_us if interval_us is not None and interval_us > 0 else 0.0)


_ELSEWHERE: Final = {
    int(mavlink.MAV_CMD_NAV_GUIDED_ENABLE): "set-points do not pass this gateway; expected an offboard command",
}


def _raw(request: Request) -> Command:
    """Any other MAV_CMD, sent to the autopilot unchanged, within what its UAV client allows."""
    if request.mav_cmd in _ELSEWHERE:
        raise Declined(f"{name_of(request.mav_cmd)}: {_ELSEWHERE[request.mav_cmd]}", UNSUPPORTED)
    if request.mav_cmd not in mavlink.enums["MAV_CMD"]:
        raise Declined(f"command {request.mav_cmd}: not in common.xml", UNSUPPORTED)
    if request.frame is not None:
        raise Declined(f"{name_of(request.mav_cmd)} as COMMAND_INT: expected COMMAND_LONG", UNSUPPORTED)
    return Mavlink(request.mav_cmd, request.params)
