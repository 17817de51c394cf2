"""The gateway's copies of the drones' plans: uploaded or read lists, until they may have changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

from ..protocol.plans import PlanList, list_hash
from ..protocol.states import Fence, Mission, State
from .clients import Client
from .endpoints import Peer
from .plan_items import Items


@dataclass(frozen=True)
class _Copy:
    items: Items

    @cached_property
    def hash(self) -> bytes:
        return list_hash(self.items)


class PlanCopies:
    """The lists of all drones, by their numbers, and the missions that clients mean, until their sockets close."""

    def __init__(self) -> None:
        self._lists: dict[int, dict[PlanList, _Copy]] = {}
        self._named: WeakKeyDictionary[Peer, dict[tuple[int, int, int], bytes]] = WeakKeyDictionary()

    def get(self, drone: int, kind: PlanList) -> Items | None:
        """A list as the drone has it; None if it is not known."""
        known = self._lists.get(drone, {}).get(kind)
        return None if known is None else known.items

    def put(self, drone: int, lists: Mapping[PlanList, Items]) -> None:
        """Store lists that were read from the drone, or that it has verified."""
        self._lists.setdefault(drone, {}).update({kind: _Copy(items) for kind, items in lists.items()})

    def name(self, client: Client, drone: int, mission: Items) -> None:
        """Note the mission that a client means from now on, whether or not the drone has it."""
        known = self._lists.get(drone, {}).get(PlanList.MISSION)
        named = known.hash if known is not None and known.items is mission else list_hash(mission)
        self._named.setdefault(client.peer, {})[client.system, client.component, drone] = named

    def mission(self, client: Client, drone: int) -> bytes | None:
        """The hash of the mission that a client means: the last one that it uploaded or read, however old."""
        return self._named.get(client.peer, {}).get((client.system, client.component, drone))

    def forget(self, drone: int) -> None:
        """Drop the lists, which may have changed. The missions that clients mean stay: the drone refuses another."""
        self._lists.pop(drone, None)

    def on_state(self, drone: int, state: State) -> None:
        """Drop the copies if a mission or fence differs: another client uploaded it, or it has not been read again."""
        if isinstance(state, Mission):
            kind, found = PlanList.MISSION, state.mission
        elif isinstance(state, Fence):
            kind, found = PlanList.FENCE, state.fence
        else:
            return
        known = self._lists.get(drone, {}).get(kind)
        if known is not None and found != known.hash:
            self.forget(drone)
