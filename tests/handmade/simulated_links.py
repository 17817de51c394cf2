"""Nodes whose probes cross simulated links: the emulator's arithmetic without a network, and without waiting."""

from __future__ import annotations

import json
import threading
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from net.emulator.link import CORRUPT, DROP, WAIT
from net.emulator.network import Network
from net.emulator.plan import parse_plan
from net.link_plan import LinkPlan
from testbed.plan.profiles.resolve import LinksPlan
from testbed.plan.topology import Link, Node, Topology

TWO = Topology((Node("gs", "198.18.0.3"), Node("cloud", "198.18.1.3")), (Link("wan:gs", "gs", "cloud"),))
UP, DOWN = "wan:gs:up", "wan:gs:down"
ETHERNET_BYTES = 14
NEVER_NS = 1 << 62


def plan_of(up: LinkPlan, down: LinkPlan | None = None, seed: int = 5) -> LinksPlan:
    """A plan of both directions between gs and cloud."""
    return LinksPlan("own", seed, {UP: up, DOWN: down or LinkPlan()}, ())


class SimulatedNodes:
    """`run` is a node's answer to a schedule; the nodes wait for each other, then all frames cross the links at once.

    `plan` has the links' true figures. The first `late` rounds begin too late; `lost` selects probes that vanish.
    """

    def __init__(
        self, plan: LinksPlan, topology: Topology = TWO, late: int = 0, lost: Callable[[int], bool] | None = None
    ):
        self.plan = plan
        self.rounds = 0
        self._topology = topology
        self._late = late
        self._lost = lost or (lambda number: False)
        self._lock = threading.Condition()
        self._asked: dict[str, dict[str, Any]] = {}
        self._answers: dict[str, str] = {}
        self.network = Network(parse_plan(plan.to_data(), "plan"))

    def run(self, node: str, command: list[str]) -> str:
        with self._lock:
            self._asked[node] = json.loads(command[-1])
            if self._is_whole():
                self._answer()
            self._lock.wait_for(lambda: node in self._answers, timeout=20)
            return self._answers.pop(node)

    def _is_whole(self) -> bool:
        addresses = {node.address: node.name for node in self._topology.nodes}
        wanted = {addresses[flow["to"]] for asked in self._asked.values() for flow in asked["flows"]}
        return bool(wanted) and wanted <= set(self._asked)

    def _answer(self) -> None:
        self.rounds += 1
        if self.rounds <= self._late:
            answer = json.dumps({"late_ms": 25.0, "overflowed": 0, "sent": {}, "arrived": {}})
            self._answers |= dict.fromkeys(self._asked, answer)
        else:
            self._answers |= {node: json.dumps(found) for node, found in self._cross().items()}
        self._asked = {}
        self._lock.notify_all()

    def _cross(self) -> dict[str, dict[str, Any]]:
        names = {node.address: node.name for node in self._topology.nodes}
        frames = sorted(self._frames())
        found: dict[str, dict[str, Any]] = {
            node: {
                "late_ms": 0,
                "overflowed": 0,
                "sent": {str(flow["flow"]): flow["count"] for flow in asked["flows"]},
                "arrived": defaultdict(lambda: {"count": 0, "rows": []}),
            }
            for node, asked in self._asked.items()
        }
        waiting: dict[Any, deque[tuple[int, str, dict[str, Any], int]]] = defaultdict(deque)

        def arrive(link: Any, fate: int, due_ns: int, sent_ns: int, to: str, flow: dict[str, Any], number: int) -> None:
            link.counters.left += fate != DROP
            if fate != DROP and not fate & CORRUPT and not self._lost(number):
                came = found[to]["arrived"][str(flow["flow"])]
                came["count"] += 1
                if flow["timed"]:
                    came["rows"].append([number, sent_ns, due_ns - self._offset_ns])

        def turns(now_ns: int) -> None:
            for each in self.network.turns:
                for link, due_ns, fate in each.advance(now_ns):
                    arrive(link, fate, due_ns, *waiting[link].popleft())

        for sent_ns, node, place, number in frames:
            flow = self._asked[node]["flows"][place]
            to = names[flow["to"]]
            link = self.network.links[str(self._topology.link_of(node, to))]
            turns(self._offset_ns + sent_ns)
            due_ns, fate = link.arrive(self._offset_ns + sent_ns, flow["bytes"])
            if fate == WAIT:
                waiting[link].append((sent_ns, to, flow, number))
            else:
                arrive(link, fate, due_ns, sent_ns, to, flow, number)
        turns(NEVER_NS)
        return found

    @property
    def _offset_ns(self) -> int:
        """The links' age, which grows with each round."""
        return self.rounds * 60_000_000_000

    def _frames(self) -> list[tuple[int, str, int, int]]:
        """When each frame is sent, by which node, of which of its flows, and its number."""
        return [
            (int((flow["at_s"] + max(0, number - flow["burst"] + 1) * flow["every_s"]) * 1e9), node, place, number)
            for node, asked in self._asked.items()
            for place, flow in enumerate(asked["flows"])
            for number in range(flow["count"])
        ]


def changed(plan: LinksPlan, link: str, **figures: Any) -> LinksPlan:
    """The plan with other figures of one link."""
    return replace(plan, links={**plan.links, link: replace(plan.links[link], **figures)})
