"""The gateway's copies of the drones' plans: uploaded or read lists, until they may have changed."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol.plans import PlanList, list_hash
from ..protocol.states import Fence, Mission, State
from .plan_items import Items


class PlanCopies:
    """The lists of all drones, by their numbers."""

    def __init__(self) -> None:
        self._lists: dict[int, dict[PlanList, Items]] = {}
        self._named: dict[int, bytes] = {}

    def get(self, drone: int, kind: PlanList) -> Items | None:
        """A list as the drone has it; None if it is not known."""
        return self._lists.get(drone, {}).get(kind)

    def put(self, drone: int, lists: Mapping[PlanList, Items]) -> None:
        """Store lists that were read from the drone, or that it has verified."""
        self._lists.setdefault(drone, {}).update(lists)
        self.name(drone, lists)

    def name(self, drone: int, lists: Mapping[PlanList, Items]) -> None:
        """Note the mission that clients mean from now on, whether or not the drone has it."""
        if PlanList.MISSION in lists:
            self._named[drone] = list_hash(lists[PlanList.MISSION])

    def mission(self, drone: int) -> bytes | None:
        """The hash of the mission that clients mean: the last one uploaded or read, however old."""
        return self._named.get(drone)

    def forget(self, drone: int) -> None:
        """Drop the lists, which may have changed. The mission that clients mean stays: the drone refuses another."""
        self._lists.pop(drone, None)

    def disown(self, drone: int) -> None:
        """An upload failed: drop the lists, and the mission that clients meant."""
        self.forget(drone)
        self._named.pop(drone, None)

    def on_state(self, drone: int, state: State) -> None:
        """Drop the copies if a mission or fence differs: another client uploaded it, or it has not been read again."""
        if isinstance(state, Mission):
            kind, found = PlanList.MISSION, state.mission
        elif isinstance(state, Fence):
            kind, found = PlanList.FENCE, state.fence
        else:
            return
        known = self.get(drone, kind)
        if known is not None and found != list_hash(known):
            self.forget(drone)
