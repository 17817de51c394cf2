"""What the gateway knows of each drone's plan: the lists that were uploaded or read, until they may be others."""

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
        """A list as the drone has it; None where that is not known."""
        return self._lists.get(drone, {}).get(kind)

    def put(self, drone: int, lists: Mapping[PlanList, Items]) -> None:
        """The drone has these lists: they were read from it, or it has verified them."""
        self._lists.setdefault(drone, {}).update(lists)
        self.name(drone, lists)

    def name(self, drone: int, lists: Mapping[PlanList, Items]) -> None:
        """The mission that clients mean from now on, whether or not the drone has it."""
        if PlanList.MISSION in lists:
            self._named[drone] = list_hash(lists[PlanList.MISSION])

    def mission(self, drone: int) -> bytes | None:
        """What names the mission that clients mean: uploaded or read last, however old that is."""
        return self._named.get(drone)

    def forget(self, drone: int) -> None:
        """The lists may be others. What clients mean stays: the drone says where that is another mission."""
        self._lists.pop(drone, None)

    def disown(self, drone: int) -> None:
        """An upload was not taken: nobody means its mission any more."""
        self.forget(drone)
        self._named.pop(drone, None)

    def on_state(self, drone: int, state: State) -> None:
        """A mission or a fence that is not the copy was uploaded by somebody else, or has not been read anew."""
        if isinstance(state, Mission):
            kind, found = PlanList.MISSION, state.mission
        elif isinstance(state, Fence):
            kind, found = PlanList.FENCE, state.fence
        else:
            return
        known = self.get(drone, kind)
        if known is not None and found != list_hash(known):
            self.forget(drone)
