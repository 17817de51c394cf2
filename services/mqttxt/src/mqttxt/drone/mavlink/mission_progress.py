"""The autopilot's progress in its mission, and whether it is outside its geofence, by its own messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.plans import PlanList
from ...protocol.states import Fence, Mission, State

_NONE = 0xFFFF
"""PX4's total if it has no mission."""
_TO_THE_GROUND = (mavlink.MAV_CMD_NAV_LAND, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)


@dataclass
class MissionProgress:
    """One autopilot's messages about its plan. `hashes` has the lists that were read and not changed since.

    `home_items`: how many items the autopilot keeps before those of the plan. The plan's items count from 1.
    """

    hashes: dict[PlanList, bytes] = field(default_factory=dict)
    lands: bool = False
    """Whether the mission that was read last ends on the ground."""
    home_items: int = 0
    current: int = 0
    reached: int = 0
    total: int = 0
    _stale: int = 0
    """The item that was reached last before a new start of the mission, until another one is."""
    _read: bytes | None = None
    """The hash of the mission that was read last."""
    _is_told: bool = False
    _breached: bool | None = None

    def on_message(self, message: Any) -> list[State]:
        """The states in a message of the mission's or the fence's progress."""
        kind = message.get_type()
        if kind == "FENCE_STATUS":
            return self._on_fence(bool(message.breach_status))
        if kind == "MISSION_ITEM_REACHED":
            self._reach(self._number(message.seq))
        else:
            self.current = self._number(message.seq)
            if message.total or message.mission_state:  # older autopilots send neither; home does not count
                self.total = 0 if message.total == _NONE else message.total
        return self.states()

    def states(self) -> list[State]:
        """The states of the mission, once there was one, and of the fence."""
        self._is_told = self._is_told or self.total > 0
        out: list[State] = []
        if self._is_told:
            out.append(Mission(self.current, self.reached, self.total, self.hashes.get(PlanList.MISSION)))
        if self._breached is not None:
            out.append(Fence(self._breached, self.hashes.get(PlanList.FENCE)))
        return out

    @property
    def is_over(self) -> bool:
        """Whether the last item was reached, or the one before if the last one lands, as it may still do."""
        return self.total > 0 and self.reached >= self.total - self.lands

    @property
    def is_landing(self) -> bool:
        """Whether the mission `is_over` and ends on the ground, so that the motors may stop."""
        return self.lands and self.is_over

    def read(self, hash: bytes, commands: Sequence[int]) -> None:
        """Note a mission that was read: its hash, and the MAV_CMDs of its items. Of a new one no item was reached."""
        if self._read not in (None, hash):
            self.begin()
        self._read = self.hashes[PlanList.MISSION] = hash
        self.lands = bool(commands) and commands[-1] in _TO_THE_GROUND
        self.total = len(commands)

    def begin(self) -> None:
        """The mission is started anew, or goes back: the item reached before belongs to an earlier flight."""
        self._stale, self.reached = self.reached or self._stale, 0

    def _reach(self, number: int) -> None:
        """Note a reached item. PX4 repeats the last one ten times, even if the mission was started anew meanwhile."""
        if number == self._stale and number != self.current:
            return
        self.reached, self._stale = number, 0

    def forget(self) -> None:
        """Forget the hashes: the lists have to be read again."""
        self.hashes.clear()

    def seq(self, item: int) -> int:
        """The autopilot's sequence number of an item of the plan."""
        return item - 1 + self.home_items

    def _number(self, seq: int) -> int:
        return max(0, int(seq) + 1 - self.home_items)

    def _on_fence(self, breached: bool) -> list[State]:
        self._breached = breached
        return [Fence(breached, self.hashes.get(PlanList.FENCE))]
