"""An autopilot's side of MAVLink's mission protocol on one link; no I/O."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from pymavlink.dialects.v20 import development as mavlink

from .autopilot import Autopilot
from .plans import Item, Partner

ACCEPTED, ERROR = int(mavlink.MAV_MISSION_ACCEPTED), int(mavlink.MAV_MISSION_ERROR)
UNSUPPORTED, WRONG_FRAME = int(mavlink.MAV_MISSION_UNSUPPORTED), int(mavlink.MAV_MISSION_UNSUPPORTED_FRAME)
NO_SPACE, DENIED = int(mavlink.MAV_MISSION_NO_SPACE), int(mavlink.MAV_MISSION_DENIED)
OUT_OF_SEQUENCE = int(mavlink.MAV_MISSION_INVALID_SEQUENCE)
CANCELLED = int(mavlink.MAV_MISSION_OPERATION_CANCELLED)


@dataclass
class Upload:
    """An upload in progress: `items` are those of `count` that have arrived, `current` is the one to begin with."""

    partner: Partner
    kind: int
    count: int
    heard_s: float
    asked_s: float = -math.inf
    items: list[Item] = field(default_factory=list)
    current: int = 0

    @property
    def is_whole(self) -> bool:
        return len(self.items) == self.count


class PlanLink(ABC):
    """The protocol on one link.

    A missing item is requested again after `asks_again_s`; a stalled upload is given up after `gives_up_s`. `most` is
    the largest number of items of each list.
    """

    asks_again_s: ClassVar[float]
    gives_up_s: ClassVar[float]
    most: ClassVar[Mapping[int, int]]

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self._plans = autopilot.plans
        self._say = autopilot.say
        self._upload: Upload | None = None

    def answer(self, message: Any, now_s: float) -> list[Any]:
        """The messages that answer one of MESSAGES."""
        handler = getattr(self, MESSAGES[message.get_type()])
        answers: list[Any] = handler(message, (message.get_srcSystem(), message.get_srcComponent()), now_s)
        return answers

    def due(self, now_s: float) -> list[Any]:
        """Repeat a request that is due, or end a stalled upload."""
        upload = self._upload
        if upload is None:
            return []
        if now_s - upload.heard_s > self.gives_up_s:
            self._upload = None
            return self.given_up(upload)
        return [self._ask(upload, now_s)] if now_s - upload.asked_s > self.asks_again_s else []

    def _begin(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        """Begin an upload whose size is allowed: request its first item; an empty list is complete at once."""
        self._upload = upload = Upload(partner, message.mission_type, message.count, now_s)
        return self._finish(upload) if upload.is_whole else [self._ask(upload, now_s)]

    def _take(self, upload: Upload, message: Any, now_s: float) -> list[Any]:
        """Take the requested item; request the next one, or finish the upload."""
        upload.heard_s = now_s
        upload.items.append(Item.of(message))
        if message.current:
            upload.current = message.seq
        return self._finish(upload) if upload.is_whole else [self._ask(upload, now_s)]

    def _finish(self, upload: Upload) -> list[Any]:
        self._upload = None
        self.keep(upload)
        return [ack(upload.partner, ACCEPTED, upload.kind)]

    def _refuse(self, upload: Upload, result: int) -> list[Any]:
        """End the upload with an error."""
        self._upload = None
        return [ack(upload.partner, result, upload.kind)]

    def _ask(self, upload: Upload, now_s: float) -> Any:
        upload.asked_s = now_s
        return self.request(upload.partner, len(upload.items), upload.kind)

    @abstractmethod
    def request(self, to: Partner, seq: int, kind: int) -> Any:
        """The message that requests an item."""

    @abstractmethod
    def keep(self, upload: Upload) -> None:
        """Put a complete list in the place of the one before."""

    @abstractmethod
    def given_up(self, upload: Upload) -> list[Any]:
        """The messages that end a stalled upload."""

    @abstractmethod
    def count(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        """MISSION_COUNT: the partner begins to upload a list."""

    @abstractmethod
    def item(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        """MISSION_ITEM_INT."""

    @abstractmethod
    def request_list(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        """MISSION_REQUEST_LIST: the partner begins to download a list."""

    @abstractmethod
    def requested(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        """MISSION_REQUEST_INT: the partner requests an item."""

    @abstractmethod
    def acknowledged(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        """MISSION_ACK: the end of a download, or of an upload that is cancelled."""

    @abstractmethod
    def clear(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        """MISSION_CLEAR_ALL."""

    @abstractmethod
    def set_current(self, message: Any, partner: Partner, now_s: float) -> list[Any]:
        """MISSION_SET_CURRENT."""


MESSAGES = {
    "MISSION_COUNT": PlanLink.count.__name__,
    "MISSION_ITEM_INT": PlanLink.item.__name__,
    "MISSION_REQUEST_LIST": PlanLink.request_list.__name__,
    "MISSION_REQUEST_INT": PlanLink.requested.__name__,
    "MISSION_ACK": PlanLink.acknowledged.__name__,
    "MISSION_CLEAR_ALL": PlanLink.clear.__name__,
    "MISSION_SET_CURRENT": PlanLink.set_current.__name__,
}
"""The protocol's messages that an autopilot receives, and the method that answers each."""


def ack(to: Partner, result: int, kind: int) -> Any:
    """MISSION_ACK."""
    return mavlink.MAVLink_mission_ack_message(*to, result, kind)
