"""ArduCopter's side of the mission protocol (MissionItemProtocol.cpp); its mission's item 0 is home."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from pymavlink.dialects.v20 import development as mavlink

from ..plan_link import (
    ACCEPTED,
    CANCELLED,
    DENIED,
    ERROR,
    NO_SPACE,
    OUT_OF_SEQUENCE,
    UNSUPPORTED,
    WRONG_FRAME,
    PlanLink,
    Upload,
    ack,
)
from ..plans import ABOVE_HOME, ABOVE_SEA, FENCE, MISSION, RALLY, Item, Partner

_FRAMES = (*ABOVE_SEA, *ABOVE_HOME, mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT, mavlink.MAV_FRAME_MISSION)
_PLACES: Mapping[int, tuple[int, ...]] = {
    mavlink.MAV_CMD_NAV_WAYPOINT: (0,),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: (),
    mavlink.MAV_CMD_NAV_LOITER_TIME: (0, 2, 3),
    mavlink.MAV_CMD_NAV_LAND: (0,),
    mavlink.MAV_CMD_NAV_TAKEOFF: (0,),
}
"""A mission's commands with a place, and which of their four parameters ArduCopter keeps."""
_OTHERS: Mapping[int, tuple[int, ...]] = {
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: (),
    mavlink.MAV_CMD_DO_JUMP: (0, 1),
    mavlink.MAV_CMD_DO_CHANGE_SPEED: (0, 1, 2),
    mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST: (0, 2),
    mavlink.MAV_CMD_CONDITION_DELAY: (0,),
    mavlink.MAV_CMD_DO_SET_SERVO: (0, 1),
}
"""The same for commands without a place, of which the stand-in has some."""
_OF_LISTS = {
    FENCE: range(mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION + 1),
    RALLY: range(mavlink.MAV_CMD_NAV_RALLY_POINT, mavlink.MAV_CMD_NAV_RALLY_POINT + 1),
}


class CopterPlanLink(PlanLink):
    """ArduCopter's side of a transfer: items are downloaded in any order, and an upload can be restarted.

    It writes in place: a broken upload leaves a part of the new list and a part of the old one.
    """

    asks_again_s = 1.0
    gives_up_s = 8.0
    most: ClassVar = {MISSION: 724, FENCE: 84, RALLY: 5}

    def _home(self) -> Item:
        place = self._autopilot.guidance.home
        x, y = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
        return Item(mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_CMD_NAV_WAYPOINT, (0, 0, 0, 0), x, y, place.altitude_m)

    def request(self, to: Partner, seq: int, kind: int) -> Any:
        return mavlink.MAVLink_mission_request_message(*to, seq, kind)

    def keep(self, upload: Upload) -> None:
        """Every item has been written by now."""
        if upload.kind == MISSION:
            self._say("Flight plan received")

    def _write(self, kind: int, items: tuple[Item, ...]) -> None:
        """Write a list in the place of the old one; item 0 of a mission is home, whatever was sent."""
        kept = [_kept(kind, item) for item in items]
        if kind == MISSION and kept:
            kept[0] = self._home()
        self._plans.put(kind, tuple(kept))

    def given_up(self, upload: Upload) -> list[Any]:
        self._say("Mission upload timeout")
        return [ack(upload.partner, CANCELLED, upload.kind)]

    def count(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        if message.mission_type not in self.most:
            return [ack(partner, UNSUPPORTED, message.mission_type)]
        if self._upload is not None and partner != self._upload.partner:
            return [ack(partner, DENIED, message.mission_type)]
        if message.count > self.most[message.mission_type]:
            return [ack(partner, NO_SPACE, message.mission_type)]
        self._write(message.mission_type, self._plans.items[message.mission_type][: message.count])
        return self._begin(message, partner, now_s)

    def item(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        upload = self._upload
        if upload is None:
            return [ack(partner, ERROR, message.mission_type)]
        if partner != upload.partner:
            return [ack(partner, DENIED, message.mission_type)]
        if message.seq != len(upload.items):
            return [ack(partner, OUT_OF_SEQUENCE, upload.kind)]
        result = _refusal(upload.kind, Item.of(message))
        if result != ACCEPTED:
            return self._refuse(upload, result)
        before = self._plans.items[upload.kind]
        self._write(upload.kind, (*before[: message.seq], Item.of(message), *before[message.seq + 1 :]))
        return self._take(upload, message, now_s)

    def request_list(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        if self._upload is not None:
            return [ack(partner, DENIED, message.mission_type)]
        count = len(self._plans.items.get(message.mission_type, ()))
        return [mavlink.MAVLink_mission_count_message(*partner, count, message.mission_type)]

    def requested(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        items = self._plans.items.get(message.mission_type, ())
        if self._upload is not None:
            return [ack(partner, DENIED, message.mission_type)]
        if message.seq >= len(items):
            return self.request_list(message, partner, now_s)
        return [items[message.seq].message(partner, message.seq, message.mission_type, False)]

    def acknowledged(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        """Ignored: a download has no state."""
        return []

    def clear(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        if message.mission_type not in self.most:
            return [ack(partner, UNSUPPORTED, message.mission_type)]
        if self._upload is not None:
            return [ack(partner, ERROR, message.mission_type)]
        self._plans.put(message.mission_type, ())
        return [ack(partner, ACCEPTED, message.mission_type)]

    def set_current(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        if message.seq >= len(self._plans.mission):
            return []
        self._plans.go_to(message.seq)
        return [mavlink.MAVLink_mission_current_message(message.seq, len(self._plans.mission) - 1)]


def _refusal(kind: int, item: Item) -> int:
    """The result of an item; ACCEPTED if ArduCopter takes it."""
    if item.frame not in _FRAMES:
        return WRONG_FRAME
    known = item.command in _OF_LISTS.get(kind, ()) if kind != MISSION else item.command in {**_PLACES, **_OTHERS}
    return ACCEPTED if known else UNSUPPORTED


def _kept(kind: int, item: Item) -> Item:
    """An item as ArduCopter gives it back."""
    if kind != MISSION:
        frame = mavlink.MAV_FRAME_GLOBAL if kind == FENCE else mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
        return replace(item, frame=frame, autocontinue=0)
    kept = {**_PLACES, **_OTHERS}[item.command]
    params = [value if place in kept else 0.0 for place, value in enumerate(item.params)]
    if item.command == mavlink.MAV_CMD_NAV_LOITER_TIME:
        params[2:] = [math.copysign(1.0, params[2]), float(params[3] > 0)]
    frame = mavlink.MAV_FRAME_GLOBAL
    if item.command in _PLACES and item.frame not in ABOVE_SEA:
        frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT if item.frame in ABOVE_HOME else item.frame
    return replace(item, frame=frame, params=(params[0], params[1], params[2], params[3]))
