"""PX4's side of the mission protocol (mavlink_mission.cpp), and the fields that it keeps of an item."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from pymavlink.dialects.v20 import development as mavlink

from ..plan_link import ACCEPTED, CANCELLED, ERROR, NO_SPACE, UNSUPPORTED, WRONG_FRAME, PlanLink, Upload, ack
from ..plans import ABOVE_HOME, ABOVE_SEA, FENCE, LISTS, MISSION, RALLY, Item, Partner

_KEPT: Mapping[int, tuple[int, ...]] = {
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
"""Commands with a place, and which of their four parameters PX4 keeps."""
_YAWS = frozenset(
    (
        *(mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_CMD_NAV_LOITER_UNLIM, mavlink.MAV_CMD_NAV_LAND),
        *(mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_NAV_VTOL_TAKEOFF, mavlink.MAV_CMD_NAV_VTOL_LAND),
    )
)
"""Those whose fourth parameter is a heading, which PX4 gives back from 0 to 360 degrees."""
_FLAGS = {mavlink.MAV_CMD_NAV_LOITER_TIME: (1, 3), mavlink.MAV_CMD_NAV_LOITER_TO_ALT: (0, 3)}
"""Parameters of which PX4 keeps only whether they are above 0."""
_PLACELESS = frozenset(
    getattr(mavlink, f"MAV_CMD_{name}")
    for name in (
        *("DO_JUMP", "NAV_ROI", "DO_SET_ROI", "DO_WINCH", "DO_GRIPPER", "DO_CHANGE_SPEED", "DO_SET_HOME"),
        *("DO_LAND_START", "DO_TRIGGER_CONTROL", "DO_DIGICAM_CONTROL", "DO_MOUNT_CONFIGURE", "DO_MOUNT_CONTROL"),
        *("DO_GIMBAL_MANAGER_PITCHYAW", "SET_CAMERA_FOCUS", "SET_CAMERA_ZOOM", "DO_GIMBAL_MANAGER_CONFIGURE"),
        *("IMAGE_START_CAPTURE", "IMAGE_STOP_CAPTURE", "VIDEO_START_CAPTURE", "VIDEO_STOP_CAPTURE"),
        *("DO_CONTROL_VIDEO", "DO_SET_CAM_TRIGG_DIST", "OBLIQUE_SURVEY", "DO_SET_CAM_TRIGG_INTERVAL"),
        *("SET_CAMERA_MODE", "DO_VTOL_TRANSITION", "NAV_DELAY", "NAV_RETURN_TO_LAUNCH"),
        *("DO_SET_ROI_WPNEXT_OFFSET", "DO_SET_ROI_NONE", "CONDITION_DELAY", "CONDITION_DISTANCE", "DO_SET_ACTUATOR"),
        *("DO_AUTOTUNE_ENABLE", "COMPONENT_ARM_DISARM"),
    )
)
_OF_LISTS = frozenset(
    command for command in _KEPT if mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT <= command <= mavlink.MAV_CMD_NAV_RALLY_POINT
)
_CORNERS = (
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)


class Px4PlanLink(PlanLink):
    """PX4's side of a transfer: one at a time, a download item by item."""

    asks_again_s = 0.25
    gives_up_s = 5.0
    most: ClassVar = {MISSION: 65_534, FENCE: 64, RALLY: 32}
    _sending: tuple[Partner, int, int] | None = None
    """The partner that downloads, its list, and the item expected next."""
    _sent_s = 0.0

    def due(self, now_s: float) -> list[Any]:
        if self._sending is not None and now_s - self._sent_s > self.gives_up_s:
            self._sending = None
            self._say("Operation timeout")
        return super().due(now_s)

    def request(self, to: Partner, seq: int, kind: int) -> Any:
        return mavlink.MAVLink_mission_request_int_message(*to, seq, kind)

    def keep(self, upload: Upload) -> None:
        items = tuple(_kept(item) for item in upload.items)
        if upload.kind == FENCE:
            items = tuple(replace(item, frame=ABOVE_SEA[1], autocontinue=0) for item in items)
        self._plans.put(upload.kind, items, upload.current)

    def given_up(self, upload: Upload) -> list[Any]:
        self._say("Operation timeout")
        return []

    def count(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        upload = self._upload
        if self._sending is not None:
            self._say("WPM: IGN MISSION_COUNT: Busy")
            return [ack(partner, ERROR, self._sending[1])]
        if upload is None:
            if message.count > self.most.get(message.mission_type, 0):
                return [ack(partner, NO_SPACE, message.mission_type)]
            return self._begin(message, partner, now_s)
        upload.heard_s = now_s
        if partner != upload.partner:
            return [ack(partner, ERROR, upload.kind)]
        if upload.items:
            self._say("WPM: REJ. CMD: Busy")
            return [ack(partner, ERROR, upload.kind)]
        return [self._ask(upload, now_s)]

    def item(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        upload = self._upload
        if upload is None:
            return self._late_item(message, partner)
        if partner != upload.partner:
            self._say("REJ. MIS ITEM: partner id mismatch")
            return []
        if message.mission_type != upload.kind:
            return [ack(partner, ERROR, upload.kind)]
        upload.heard_s = now_s
        if message.seq != len(upload.items):
            return []
        result = _refusal(upload.kind, Item.of(message))
        if result != ACCEPTED:
            if result != ERROR:
                self._say("IGN MISSION_ITEM: Invalid item")
            return self._refuse(upload, result)
        return self._take(upload, message, now_s)

    def _late_item(self, message: Any, partner: Partner) -> list[Any]:
        """Acknowledge the last item again if its acknowledgement was lost; refuse any other."""
        if message.seq + 1 == len(self._plans.items.get(message.mission_type, ())):
            return [ack(partner, ACCEPTED, message.mission_type)]
        self._say("IGN MISSION_ITEM: No transfer")
        return [ack(partner, ERROR, message.mission_type)]

    def request_list(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        sending = self._sending
        is_over = sending is not None and sending[2] == len(self._plans.items[sending[1]])
        is_again = sending is not None and sending[:2] == (partner, message.mission_type)
        if message.mission_type not in LISTS:
            return []
        if self._upload is not None or (sending is not None and not is_over and not is_again):
            self._say("Mission download request ignored, already active")
            return []
        self._sending, self._sent_s = (partner, message.mission_type, 0), now_s
        count = len(self._plans.items[message.mission_type])
        return [mavlink.MAVLink_mission_count_message(*partner, count, message.mission_type)]

    def requested(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        if self._sending is None:
            return []
        to, kind, expected = self._sending
        if partner != to:
            self._say("WPM: REJ. CMD: partner id mismatch")
            return []
        if message.mission_type != kind:
            return []
        items = self._plans.items[kind]
        is_next = message.seq == expected and expected < len(items)
        if not (is_next or message.seq == expected - 1) or message.seq >= len(items):
            self._sending = None
            self._say("WPM: REJ. CMD: Req. WP was unexpected")
            return [ack(partner, ERROR, kind)]
        self._sending, self._sent_s = (to, kind, message.seq + 1), now_s
        return [items[message.seq].message(partner, message.seq, kind, message.seq == self._plans.current)]

    def acknowledged(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        if self._sending is not None and self._sending[:2] == (partner, message.mission_type):
            self._sending = None
        upload = self._upload
        if upload is not None and upload.partner == partner and message.type == CANCELLED:
            self._upload = None
        return []

    def clear(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        if self._upload is not None or self._sending is not None:
            self._say("WPM: IGN CLEAR CMD: Busy")
            return []
        every = message.mission_type == mavlink.MAV_MISSION_TYPE_ALL
        for kind in LISTS if every else (message.mission_type,):
            self._plans.put(kind, ())
        return [ack(partner, ACCEPTED, message.mission_type)]

    def set_current(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        if self._upload is not None or self._sending is not None:
            self._say("WPM: IGN WP CURR CMD: Busy")
        elif message.seq >= len(self._plans.mission):
            self._say("WPM: WP CURR CMD: Not in list")
        else:
            self._plans.go_to(message.seq)
        return []


def _refusal(kind: int, item: Item) -> int:
    """The result of an item; ACCEPTED if PX4 takes it."""
    if item.frame not in (*ABOVE_SEA, *ABOVE_HOME, mavlink.MAV_FRAME_MISSION):
        return WRONG_FRAME
    if item.command not in (_PLACELESS if item.frame == mavlink.MAV_FRAME_MISSION else _KEPT):
        return UNSUPPORTED
    if kind == MISSION and item.command in _OF_LISTS:
        return ERROR
    return ERROR if kind == FENCE and item.command in _CORNERS and round(item.params[0]) < 3 else ACCEPTED


def _kept(item: Item) -> Item:
    """An item as PX4 gives it back."""
    if item.frame == mavlink.MAV_FRAME_MISSION:
        return item
    frame = ABOVE_SEA[1] if item.frame in ABOVE_SEA else ABOVE_HOME[1]
    kept = _KEPT[item.command]
    flags = _FLAGS.get(item.command, ())
    params = [0.0] * 4
    for place in kept:
        value = item.params[place]
        if place in flags:
            value = float(value > 0)
        elif place == 3 and item.command in _YAWS:
            value = value % 360
        params[place] = value
    return replace(item, frame=frame, params=(params[0], params[1], params[2], params[3]))
