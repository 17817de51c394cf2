"""Which nodes have an old revocation list: beacons and births name it, in a fleet that signs (R12.18)."""

from __future__ import annotations

from ..core.clock import BEACON_INTERVAL_MS
from .outcomes import ListBehind

BEHIND_MS = 3 * BEACON_INTERVAL_MS
"""How long a node may have an old list, while the newer one is on its way, before it is reported."""


class ListWatch:
    """Watches the nodes' lists for the ground station `name`. Times are of its session clock."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._newest = 0
        self._since_ms: dict[str, int] = {}
        self._told: dict[str, int] = {}

    def observe(self, fog: int, node: str, number: int | None, own: int, now_ms: int) -> list[ListBehind]:
        """Note the list number of a node and this station's, `own`; returns those that were behind for too long."""
        self._newest = max(self._newest, number or 0, own)
        return [*self._judge(fog, node, number or 0, now_ms), *self._judge(fog, self._name, own, now_ms)]

    def _judge(self, fog: int, node: str, number: int, now_ms: int) -> list[ListBehind]:
        if number >= self._newest:
            self._since_ms.pop(node, None)
            self._told.pop(node, None)
            return []
        since_ms = self._since_ms.setdefault(node, now_ms)
        if now_ms - since_ms < BEHIND_MS or self._told.get(node) == self._newest:
            return []
        self._told[node] = self._newest
        return [ListBehind(fog, node, number, self._newest)]
