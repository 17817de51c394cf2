"""The plans that an autopilot keeps: its mission, geofence and rally points."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

MISSION = int(mavlink.MAV_MISSION_TYPE_MISSION)
FENCE = int(mavlink.MAV_MISSION_TYPE_FENCE)
RALLY = int(mavlink.MAV_MISSION_TYPE_RALLY)
LISTS = (MISSION, FENCE, RALLY)
ABOVE_SEA = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
ABOVE_HOME = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
"""The frames of a place by what its height counts from; the second of each is COMMAND_INT's."""
Partner = tuple[int, int]
"""System and component id of the other end of a transfer."""


@dataclass(frozen=True)
class Item:
    """One item: `x` and `y` are in degrees times 1e7 if the frame is a place on the globe."""

    frame: int
    command: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float
    autocontinue: int = 1

    @classmethod
    def of(cls, message: Any) -> Item:
        """From MISSION_ITEM_INT."""
        params = (message.param1, message.param2, message.param3, message.param4)
        return cls(message.frame, message.command, params, message.x, message.y, message.z, message.autocontinue)

    def message(self, to: Partner, seq: int, kind: int, current: bool) -> Any:
        """As MISSION_ITEM_INT."""
        system, component = to
        param1, param2, param3, param4 = self.params
        return mavlink.MAVLink_mission_item_int_message(
            target_system=system,
            target_component=component,
            seq=seq,
            frame=self.frame,
            command=self.command,
            current=int(current),
            autocontinue=self.autocontinue,
            param1=param1,
            param2=param2,
            param3=param3,
            param4=param4,
            x=self.x,
            y=self.y,
            z=self.z,
            mission_type=kind,
        )


@dataclass
class Plans:
    """The three lists by MAV_MISSION_TYPE. `current` is the mission's item that is flown, or will be when it is flown.

    `reached` is the item reached last. `changed` counts changes of the mission, so that its flight notices them.
    """

    items: dict[int, tuple[Item, ...]] = field(default_factory=lambda: dict.fromkeys(LISTS, ()))
    current: int = 0
    reached: int | None = None
    changed: int = 0

    @property
    def mission(self) -> tuple[Item, ...]:
        return self.items[MISSION]

    @property
    def is_over(self) -> bool:
        """Whether no item of the mission is left."""
        return self.current >= len(self.mission) or self.reached == len(self.mission) - 1

    def put(self, kind: int, items: tuple[Item, ...], current: int = 0) -> None:
        """Replace a list; a mission begins at its item `current`."""
        self.items[kind] = items
        if kind == MISSION:
            self.current, self.reached = current, None
            self.changed += 1

    def go_to(self, seq: int) -> None:
        """Continue the mission with an item."""
        self.current, self.reached = seq, None
        self.changed += 1
