"""Nodes on machines whose clocks differ: probes take a known time, and each node reports times by its own clock."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from typing import Any


class ClockedNodes:
    """`run` is a node's answer to a schedule. The nodes of `addresses` wait for each other.

    `ahead_ns` says how far a node's clock is ahead, `takes_ns` how long a probe takes; None: it does not arrive.
    """

    def __init__(
        self, addresses: Mapping[str, str], ahead_ns: Mapping[str, int], takes_ns: Mapping[tuple[str, str], int | None]
    ) -> None:
        self._names = addresses
        self._ahead_ns, self._takes_ns = ahead_ns, takes_ns
        self._lock = threading.Condition()
        self._asked: dict[str, dict[str, Any]] = {}
        self._answered: set[str] = set()

    def run(self, node: str, command: list[str]) -> str:
        with self._lock:
            self._asked[node] = json.loads(command[-1])
            self._lock.notify_all()
            wanted = {node, *self._names.values()}
            assert self._lock.wait_for(lambda: wanted <= set(self._asked), timeout=20)
            answer = self._answer(node)
            self._answered.add(node)
            if self._answered == set(self._asked):
                self._asked, self._answered = {}, set()
            return json.dumps(answer)

    def _answer(self, node: str) -> dict[str, Any]:
        own = self._asked[node]
        arrived: dict[str, Any] = {}
        for source, asked in self._asked.items():
            for flow in asked["flows"]:
                takes_ns = self._takes_ns[source, node] if self._names[flow["to"]] == node else None
                if takes_ns is not None:
                    rows = [self._row(flow, number, source, node, takes_ns) for number in range(flow["count"])]
                    arrived[str(flow["flow"])] = {"count": len(rows), "rows": rows}
        sent = {str(flow["flow"]): flow["count"] for flow in own["flows"]}
        return {"late_ms": 0, "overflowed": 0, "sent": sent, "arrived": arrived}

    def _row(self, flow: Mapping[str, Any], number: int, source: str, node: str, takes_ns: int) -> list[int]:
        """A probe's row, computed by a true clock: the source begins when its own clock says so, and so on."""
        due_ns = int((flow["at_s"] + max(0, number - flow["burst"] + 1) * flow["every_s"]) * 1e9)
        begin_ns = self._asked[node]["begin_ns"]
        sent_at_source_ns = self._asked[source]["begin_ns"] + due_ns
        sent_ns = sent_at_source_ns - self._ahead_ns.get(source, 0)
        received_at_node_ns = sent_ns + takes_ns + self._ahead_ns.get(node, 0)
        return [number, sent_at_source_ns - begin_ns, received_at_node_ns - begin_ns]
