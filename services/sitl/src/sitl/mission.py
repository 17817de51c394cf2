"""The flight of a mission: its current item, where that leads, and when the mission is over."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum, auto

from pymavlink.dialects.v20 import development as mavlink

from .dynamics import Vector
from .guidance import Guidance
from .outputs import Happened, Output, Reply
from .plans import ABOVE_HOME, Item, Plans


class Leg(Enum):
    """How the drone flies an item: climb, go to a place, stay there for good, land, return; OVER: no item is left."""

    TAKEOFF = auto()
    GO = auto()
    STAY = auto()
    LAND = auto()
    RETURN = auto()
    OVER = auto()


_LEGS = {
    mavlink.MAV_CMD_NAV_TAKEOFF: Leg.TAKEOFF,
    mavlink.MAV_CMD_NAV_WAYPOINT: Leg.GO,
    mavlink.MAV_CMD_NAV_LOITER_TIME: Leg.GO,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: Leg.STAY,
    mavlink.MAV_CMD_NAV_LAND: Leg.LAND,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: Leg.RETURN,
}
"""All other commands are done as soon as they are current."""
_TIMED = (mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_CMD_NAV_LOITER_TIME)


@dataclass
class MissionFlight:
    """A mission in flight. `leg` and `target` are those of the current item; `leg` is OVER when no item is left.

    It begins with the item `first`; `speed_m_s` is the speed that an item has set.
    """

    plans: Plans
    guidance: Guidance
    first: int = 0
    leg: Leg = Leg.OVER
    target: Vector = (0.0, 0.0, 0.0)
    speed_m_s: float | None = None
    _changed: int = -1
    _arrived_s: float | None = None
    _jumps: dict[int, int] = field(default_factory=dict)
    _last_told: int | None = None

    def begin(self) -> list[Output]:
        """Begin when the mode is entered: with the current item, or with the first one if the mission was over."""
        if self.plans.is_over or self.plans.current < self.first:
            self.plans.go_to(self.first)
        return self._aim()

    @property
    def waits(self) -> bool:
        """Whether the current item keeps the drone at its target for a time."""
        current = self.plans.mission[self.plans.current :][:1]
        return any(item.command in _TIMED and item.params[0] > 0 for item in current)

    def step(self, now_s: float, is_there: bool) -> list[Output]:
        """Go on to the next item when `is_there`, at the leg's target. The drone ends legs that lead to the ground."""
        if self._changed != self.plans.changed:
            return self._aim()
        if not is_there or self.leg not in (Leg.TAKEOFF, Leg.GO):
            self._arrived_s = None
            return []
        self._arrived_s = now_s if self._arrived_s is None else self._arrived_s
        item = self.plans.mission[self.plans.current]
        if item.command in _TIMED and now_s - self._arrived_s < item.params[0]:
            return []
        self._pass()
        return self._aim()

    def _aim(self) -> list[Output]:
        """Take up the current item, past those that are done at once; of several done, the last is reported."""
        self._changed, self._arrived_s = self.plans.changed, None
        while self.plans.current < len(self.plans.mission):
            item = self.plans.mission[self.plans.current]
            if item.command in _LEGS:
                self.leg, self.target = _LEGS[item.command], self._place(item)
                return self._told()
            if item.command == mavlink.MAV_CMD_DO_CHANGE_SPEED and item.params[1] > 0:
                self.speed_m_s = item.params[1]
            self._pass(self._jump(item))
        self.leg = Leg.OVER
        return self._told()

    def arrive(self) -> list[Output]:
        """Mark the current item as reached and keep it current: nothing follows a landing or a return."""
        self.plans.reached = self.plans.current
        return self._told()

    def _jump(self, item: Item) -> int | None:
        """The item to which DO_JUMP leads; None for other items and after the last repetition."""
        if item.command != mavlink.MAV_CMD_DO_JUMP:
            return None
        done = self._jumps.get(self.plans.current, 0)
        if done >= item.params[1]:
            return None
        self._jumps[self.plans.current] = done + 1
        return round(item.params[0])

    def _pass(self, jump: int | None = None) -> None:
        """Mark the current item as reached, and make the next one current, or `jump`."""
        self.plans.reached = self.plans.current
        self.plans.current = self.plans.current + 1 if jump is None else jump

    def _told(self) -> list[Output]:
        """MISSION_ITEM_REACHED, if the item reached last has not been reported yet."""
        seq = self.plans.reached
        if seq is None or seq == self._last_told:
            return []
        self._last_told = seq
        return [Happened("item_reached", {"item": seq}), Reply(mavlink.MAVLink_mission_item_reached_message(seq))]

    def _place(self, item: Item) -> Vector:
        """An item's place; the drone's own where the item names none."""
        north, east, here = self.guidance.motion.position
        if item.frame == mavlink.MAV_FRAME_MISSION:
            return north, east, here
        if (item.x, item.y) != (0, 0):
            north, east = self.guidance.origin.metres_to(item.x / 1e7, item.y / 1e7)
        if not math.isfinite(item.z):
            return north, east, here
        base = self.guidance.home_up_m if item.frame in ABOVE_HOME else -self.guidance.origin.altitude_m
        return north, east, item.z + base
