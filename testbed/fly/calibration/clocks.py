"""Measures how far the clocks of several machines are apart, and the round trip to each besides all links.

`net` and a node of each machine send each other datagrams over a path that nothing shapes. The round trip is the time
of the overlay and the two kernels. Half of the difference between the fastest datagrams of the two directions is how
far the node's clock is ahead of that of `net`, with an uncertainty of half the round trip.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

from ...plan.fleet import Fleet
from ...plan.machines import Machine
from .calibrate import Arrivals, RunInNode, run_schedule
from .schedule import DELAY, Flow, Schedule

NET, HERE, HERE_NODE = "net", "this machine", "gs"
COUNT, EVERY_S, AFTER_S = 60, 0.02, 0.3
FURTHEST_MS = 50.0
"""Clocks that are further apart are not synchronized, and may drift in flight."""


@dataclass(frozen=True)
class Way:
    """The round trip from `net` to a machine's nodes, and how far its clock is ahead; ms, None if no probe arrived."""

    machine: str
    nodes: tuple[str, ...]
    round_trip_ms: float | None
    ahead_ms: float | None

    @property
    def off(self) -> str | None:
        """Why nothing can be measured on this machine; None if it can."""
        if self.ahead_ms is None:
            return f"{self.machine}: no datagram came from {self.nodes[0]} to net or back"
        if abs(self.ahead_ms) > FURTHEST_MS:
            expected = f"{FURTHEST_MS:g} ms or less (NTP)"
            return f"{self.machine}: its clock is {self.ahead_ms:+.1f} ms from this one's: expected {expected}"
        return None

    def to_data(self) -> dict[str, Any]:
        """The entry in a manifest."""
        return asdict(self)


def measure_ways(fleet: Fleet, machines: Sequence[Machine], run_in_node: RunInNode) -> tuple[Way, ...]:
    """Measure the way to this machine, for comparison, then to each of `machines`; empty without any. Takes about 2 s.

    Raises FleetError if a probe cannot be run or does not begin in time.
    """
    if not machines:
        return ()
    nodes = {HERE: (HERE_NODE,), **{machine.name: machine.nodes for machine in machines}}
    flows: list[Flow] = []
    for place, (first, *_) in enumerate(nodes.values()):
        at_s = round(place * EVERY_S / len(nodes), 6)
        ends = ((NET, first, fleet.address(first)), (first, NET, fleet.gateway(first)))
        flows += [Flow(2 * place + way, first, DELAY, *end, at_s, EVERY_S, COUNT) for way, end in enumerate(ends)]
    schedule = Schedule(tuple(flows), COUNT * EVERY_S + AFTER_S)
    came = run_schedule(schedule, run_in_node)
    return tuple(
        _way(name, own, came[2 * place], came[2 * place + 1]) for place, (name, own) in enumerate(nodes.items())
    )


def ahead_ns(ways: Sequence[Way]) -> Mapping[str, int]:
    """By node how far its clock is ahead of that of `net`, ns."""
    return {node: round((way.ahead_ms or 0.0) * 1e6) for way in ways for node in way.nodes}


def _way(machine: str, nodes: tuple[str, ...], out: Arrivals, back: Arrivals) -> Way:
    there, here = ([(row.received_ns - row.sent_ns) / 1e6 for row in came.rows] for came in (out, back))
    if not there or not here:
        return Way(machine, nodes, None, None)
    return Way(machine, nodes, round(median(there) + median(here), 3), round((min(there) - min(here)) / 2, 3))
