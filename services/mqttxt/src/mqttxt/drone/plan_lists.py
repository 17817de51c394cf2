"""A drone's plan as its autopilot has it: read, replaced as a whole, and compared with the uploaded one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from pymavlink.dialects.v20 import common as mavlink

from ..protocol.plans import PlanItem, PlanList, list_hash
from .mavlink.mission_protocol import (
    FENCE_CIRCLES,
    FENCE_CORNERS,
    ExchangeFailed,
    Steps,
    jumping,
    plain_frame,
    read,
    set_current,
    write,
)
from .mavlink.plans import CannotExecute
from .mavlink.vehicle import Vehicle

Items = tuple[PlanItem, ...]
_HOME = PlanItem(mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_CMD_NAV_WAYPOINT, (0.0, 0.0, 0.0, 0.0), 0, 0, 0.0, True)
"""The placeholder for home, which an autopilot fills in itself."""
_CLOSE = 1e-3


def check_nulls(lists: Mapping[PlanList, Items]) -> None:
    """Raises CannotExecute for an item whose altitude, radius or number of corners is null.

    PX4 1.15 and main accept a null radius or altitude. ArduCopter's process ends by it, or it refuses the mission.
    """
    for kind, items in lists.items():
        for number, item in enumerate(items, start=1):
            if item.command in (*FENCE_CORNERS, *FENCE_CIRCLES) and item.params[0] is None:
                raise CannotExecute(f"{kind.label} item {number}: param1 is null")
            if kind is not PlanList.FENCE and item.frame != mavlink.MAV_FRAME_MISSION and item.z is None:
                raise CannotExecute(f"{kind.label} item {number}: its altitude is null")


class OtherPlan(ExchangeFailed):
    """The autopilot's mission is not the one that the command names, or lacks its item; nothing is begun."""


@dataclass
class PlanLists:
    """The three lists of one autopilot. `_written` has those that were written and read back, as uploaded."""

    vehicle: Vehicle
    _written: dict[PlanList, Items] = field(default_factory=dict)

    def fetch(self, kind: PlanList) -> Steps[Items]:
        """Read a list, in the form of the plan, and note its hash."""
        found = self._of_autopilot((yield from self._read(kind)), kind)
        known = self._written.get(kind)
        if known is None or not self._alike(known, found, kind):
            known = found
        self._know(kind, known)
        return known

    def _know(self, kind: PlanList, items: Items) -> None:
        if kind is PlanList.MISSION:
            self.vehicle.mission.read(list_hash(items), [item.command for item in items])
        else:
            self.vehicle.mission.hashes[kind] = list_hash(items)

    def fetch_all(self) -> Steps[dict[PlanList, Items]]:
        """Read all three lists."""
        found = {}
        for kind in PlanList:
            found[kind] = yield from self.fetch(kind)
        return found

    def replace(self, wanted: Mapping[PlanList, Items]) -> Steps[None]:
        """Replace lists by `wanted`, or restore all and raise ExchangeFailed ("partial, ..." if that failed).

        A list that the autopilot already has is not written.
        """
        before = {}
        for kind in wanted:
            before[kind] = yield from self.fetch(kind)
        changed: list[PlanList] = []
        try:
            for kind, items in wanted.items():
                if not self._alike(items, before[kind], kind):
                    changed.append(kind)
                    yield from self._put(kind, items)
                self._written[kind] = items
                self._know(kind, items)
        except ExchangeFailed as error:
            if not (yield from self._put_back({kind: before[kind] for kind in changed})):
                raise ExchangeFailed(f"partial, {error}") from error
            raise

    def select(self, mission: bytes, item: int | None) -> Steps[None]:
        """Make `item` of the mission with that hash the current one; None leaves it. Raises OtherPlan.

        Where the current item was reached already, the mission is flown again from there.
        """
        items = yield from self.fetch(PlanList.MISSION)
        if self.vehicle.mission.hashes[PlanList.MISSION] != mission:
            raise OtherPlan("other_plan")
        if not items:
            raise OtherPlan("no_mission")
        if item is not None and item > len(items):
            raise OtherPlan(f"no_such_item, {len(items)}")
        if item is not None:
            yield from set_current(self.vehicle.system_id, self.vehicle.mission.seq(item))
        if self.vehicle.mission.current <= self.vehicle.mission.reached:
            self.vehicle.mission.begin()

    def _put(self, kind: PlanList, items: Items) -> Steps[None]:
        """Write a list and read it back. Raises ExchangeFailed with the first item that differs."""
        self.vehicle.mission.hashes.pop(kind, None)
        home_items = self._home_items(kind)
        yield from write(self.vehicle.system_id, kind, self._for_autopilot(items, kind), home_items)
        found = self._of_autopilot((yield from self._read(kind)), kind)
        if len(found) != len(items):
            raise ExchangeFailed(f"{kind.label}: {len(found)} items of {len(items)} were read back")
        for number, (one, other) in enumerate(zip(items, found, strict=True), start=1):
            if not self._alike((one,), (other,), kind):
                raise ExchangeFailed(f"{kind.label} item {number}: read back as another one")

    def _put_back(self, before: Mapping[PlanList, Items]) -> Steps[bool]:
        """Restore the lists; returns whether that succeeded."""
        try:
            for kind, items in before.items():
                if not self._alike(items, (yield from self.fetch(kind)), kind):
                    yield from self._put(kind, items)
                    yield from self.fetch(kind)
        except ExchangeFailed:
            return False
        return True

    def _read(self, kind: PlanList) -> Steps[Items]:
        return (yield from read(self.vehicle.system_id, kind, self._home_items(kind)))

    def _home_items(self, kind: PlanList) -> int:
        return self.vehicle.mission.home_items if kind is PlanList.MISSION else 0

    def _for_autopilot(self, items: Items, kind: PlanList) -> Items:
        """Items in the autopilot's form: home in front if it keeps one there, and jumps by its own numbers."""
        if not items:
            return ()
        return (_HOME,) * self._home_items(kind) + tuple(jumping(item, self._home_items(kind) - 1) for item in items)

    def _of_autopilot(self, items: Items, kind: PlanList) -> Items:
        home_items = self._home_items(kind)
        own = (replace(item, frame=plain_frame(item.frame)) for item in items[home_items:])
        return tuple(jumping(item, 1 - home_items) for item in own)

    def _alike(self, wanted: Items, found: Items, kind: PlanList) -> bool:
        """Whether two lists are equal in the fields that this kind of autopilot keeps.

        Fence corners have no height, and neither they nor rally points have `autocontinue`.
        """
        kept = self.vehicle.autopilot.kept if kind is PlanList.MISSION else _corner
        pairs = zip(wanted, found, strict=False)
        return len(wanted) == len(found) and all(_close(kept(one), kept(other)) for one, other in pairs)


def _corner(item: PlanItem) -> PlanItem:
    is_rally = item.command == mavlink.MAV_CMD_NAV_RALLY_POINT
    z, first = (item.z, 0.0) if is_rally else (0.0, item.params[0])
    frame = item.frame if is_rally else mavlink.MAV_FRAME_GLOBAL
    return replace(item, frame=frame, params=(first, 0.0, 0.0, 0.0), z=z, autocontinue=False)


def _close(one: PlanItem, other: PlanItem) -> bool:
    """Whether two items are equal, up to rounding."""
    floats = [(*each.params, each.z) for each in (one, other)]
    if (one.command, one.x, one.y, one.autocontinue) != (other.command, other.x, other.y, other.autocontinue):
        return False
    return plain_frame(one.frame) == plain_frame(other.frame) and all(_same(a, b) for a, b in zip(*floats, strict=True))


def _same(a: float | None, b: float | None) -> bool:
    if a is None or b is None:
        return a is b
    return math.isclose(a, b, rel_tol=1e-6, abs_tol=_CLOSE)
