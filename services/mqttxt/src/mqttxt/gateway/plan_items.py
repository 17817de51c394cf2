"""A plan's items as MAVLink clients send and read them, and the checks of them (docs/gateway.md)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ..drone.mavlink.mission_protocol import (
    FENCE_CIRCLES,
    FENCE_CORNERS,
    INT_FRAMES,
    item_of,
    jumping,
    message_of,
    plain_frame,
)
from ..protocol.plans import MOST_ITEMS, PlanItem, PlanList
from ..protocol.states import Airframe, Home
from .telemetry import UNKNOWN_AUTOPILOT, View

Items = tuple[PlanItem, ...]
_GLOBAL, _NO_PLACE = int(mavlink.MAV_FRAME_GLOBAL), int(mavlink.MAV_FRAME_MISSION)
_COMMANDS: Final[dict[PlanList, frozenset[int]]] = {
    PlanList.MISSION: frozenset(mavlink.enums["MAV_CMD"]),
    PlanList.FENCE: frozenset((*FENCE_CORNERS, *FENCE_CIRCLES, mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT)),
    PlanList.RALLY: frozenset((mavlink.MAV_CMD_NAV_RALLY_POINT,)),
}
_LEAST_CORNERS = 3
_DEGREES = 1e7


class WrongItem(Exception):
    """A list that is refused, with its `result` for MISSION_ACK; the message is for people."""

    def __init__(self, result: int, text: str) -> None:
        super().__init__(text)
        self.result = result


def home_items(kind: PlanList, view: View) -> int:
    """How many items precede the plan's own in a client's list: with ArduPilot home is item 0 of a mission.

    Raises WrongItem while the kind of autopilot is not known.
    """
    if kind is not PlanList.MISSION:
        return 0
    if view.get(Airframe) is None:
        raise WrongItem(mavlink.MAV_MISSION_ERROR, UNKNOWN_AUTOPILOT)
    return view.home_items


def check_count(count: int, kind: PlanList) -> None:
    """Raises WrongItem if a list has no room for that many items."""
    if count > MOST_ITEMS:
        raise WrongItem(mavlink.MAV_MISSION_NO_SPACE, f"{kind.label}: expected at most {MOST_ITEMS} items, got {count}")


def item_from(message: Any, kind: PlanList, number: int) -> PlanItem:
    """The plan's item in a MISSION_ITEM_INT or MISSION_ITEM, as item `number`; raises WrongItem."""
    frame = plain_frame(message.frame)
    is_placed = frame in INT_FRAMES
    if not is_placed and (frame != _NO_PLACE or kind is not PlanList.MISSION):
        expected = "a global frame" if kind is not PlanList.MISSION else "a global frame or MAV_FRAME_MISSION"
        raise _wrong(mavlink.MAV_MISSION_UNSUPPORTED_FRAME, kind, number, "frame", expected, message.frame)
    if message.command not in _COMMANDS[kind]:
        expected = "a MAV_CMD of common.xml" if kind is PlanList.MISSION else f"a MAV_CMD of a {kind.label} list"
        raise _wrong(mavlink.MAV_MISSION_UNSUPPORTED, kind, number, "command", expected, message.command)
    for place, param in enumerate((message.param1, message.param2, message.param3, message.param4), start=1):
        if math.isinf(param):
            result = mavlink.MAV_MISSION_INVALID_PARAM1 + place - 1
            raise _wrong(result, kind, number, f"param{place}", "a number or NaN", param)
    if math.isinf(message.z) or (is_placed and math.isnan(message.z)):
        raise _wrong(mavlink.MAV_MISSION_INVALID_PARAM7, kind, number, "altitude", "metres", message.z)
    _check_place(message, kind, number, is_placed)
    if message.get_type() == "MISSION_ITEM":
        scale = _DEGREES if is_placed else 1
        message.x, message.y = round(message.x * scale), round(message.y * scale)
    return replace(item_of(message), frame=frame)


def _check_place(message: Any, kind: PlanList, number: int, is_placed: bool) -> None:
    is_int = message.get_type() == "MISSION_ITEM_INT"
    sides = (
        (message.x, 90.0, "latitude", mavlink.MAV_MISSION_INVALID_PARAM5_X),
        (message.y, 180.0, "longitude", mavlink.MAV_MISSION_INVALID_PARAM6_Y),
    )
    for value, most, what, result in sides:
        if is_placed:
            degrees = value / _DEGREES if is_int else value
            if not abs(degrees) <= most:
                raise _wrong(result, kind, number, what, f"-{most:g} to {most:g} degrees", degrees)
        elif not abs(value) < 2**31 + is_int:
            raise _wrong(result, kind, number, f"param{5 + (what == 'longitude')}", "a whole number of 32 bits", value)


def plan_list(items: Items, kind: PlanList, before: int) -> Items:
    """The plan's list of a client's items, which `before` others precede; raises WrongItem for inconsistent items."""
    if kind is PlanList.FENCE:
        _check_polygons(items)
    out, last = [], before + len(items) - 1
    for number, item in enumerate(items, start=1):
        if item.command == mavlink.MAV_CMD_DO_JUMP:
            target = item.params[0]
            if target is None or target != int(target) or not before <= target <= last:
                expected = f"an item from {before} to {last}"
                raise _wrong(mavlink.MAV_MISSION_INVALID_PARAM1, kind, number, "DO_JUMP", expected, target)
        out.append(jumping(item, 1 - before))
    return tuple(out)


def _check_polygons(items: Items) -> None:
    """Raises WrongItem unless each polygon has consecutive corners that name their count, and each circle a radius."""
    at = 0
    while at < len(items):
        item, first = items[at], items[at].params[0] or 0.0
        if item.command in FENCE_CIRCLES and not first > 0:
            raise _wrong(mavlink.MAV_MISSION_INVALID_PARAM1, PlanList.FENCE, at + 1, "radius", "metres above 0", first)
        if item.command not in FENCE_CORNERS:
            at += 1
            continue
        if first < _LEAST_CORNERS or first != int(first):
            raise _wrong(
                mavlink.MAV_MISSION_INVALID_PARAM1, PlanList.FENCE, at + 1, "corners", "3 or more in param1", first
            )
        corners = items[at : at + int(first)]
        strays = (
            number
            for number, corner in enumerate(corners, start=at + 1)
            if (corner.command, corner.params[0]) != (item.command, first)
        )
        stray = next(strays, at + len(corners) + 1 if len(corners) < first else None)
        if stray is not None:
            expected = f"one of {first:g} corners that follow each other"
            got = "the end" if stray > len(items) else "another item"
            raise _wrong(mavlink.MAV_MISSION_INVALID, PlanList.FENCE, stray, "polygon", expected, got)
        at += len(corners)


def client_list(items: Items, kind: PlanList, view: View) -> Items:
    """A plan's list as the drone's clients see it; raises WrongItem as `home_items`."""
    before = home_items(kind, view)
    if not before or not items:
        return tuple(jumping(item, -1) for item in items)
    home = view.get(Home)
    x, y, z = 0, 0, 0.0
    if home is not None:
        x, y, z = round(home.latitude_deg * _DEGREES), round(home.longitude_deg * _DEGREES), home.altitude_amsl_m
    first = PlanItem(_GLOBAL, mavlink.MAV_CMD_NAV_WAYPOINT, (0.0, 0.0, 0.0, 0.0), x, y, z, autocontinue=True)
    return (first, *items)


def item_message(item: PlanItem, target: tuple[int, int], seq: int, kind: PlanList, as_int: bool) -> Any:
    """MISSION_ITEM_INT, or MISSION_ITEM for old clients."""
    message = message_of(replace(item, frame=INT_FRAMES.get(item.frame, item.frame)), target, seq, kind)
    if as_int:
        return message
    scale = _DEGREES if item.frame in INT_FRAMES else 1
    system, component = target
    return mavlink.MAVLink_mission_item_message(
        target_system=system,
        target_component=component,
        seq=seq,
        frame=item.frame,
        command=item.command,
        current=message.current,
        autocontinue=message.autocontinue,
        param1=message.param1,
        param2=message.param2,
        param3=message.param3,
        param4=message.param4,
        x=item.x / scale,
        y=item.y / scale,
        z=message.z,
        mission_type=kind,
    )


def _wrong(result: int, kind: PlanList, number: int, field: str, expected: str, got: object) -> WrongItem:
    shown = f"{got:g}" if isinstance(got, float) else got
    return WrongItem(result, f"{kind.label} item {number}: {field}: expected {expected}, got {shown}")
