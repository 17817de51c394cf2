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
from .calibrate import FlowResult, RunInNode, run_schedule
from .schedule import DELAY, CalibrationFlow, CalibrationSchedule

NET, HERE, HERE_NODE = "net", "this machine", "gs"
COUNT, EVERY_S, AFTER_S = 60, 0.02, 0.3
FURTHEST_MS = 50.0
"""Clocks that are further apart are not synchronized, and may drift in flight."""


@dataclass(frozen=True)
class MachineClock:
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


def measure_clocks(fleet: Fleet, machines: Sequence[Machine], run_in_node: RunInNode) -> tuple[MachineClock, ...]:
    """Measure the way to this machine, for comparison, then to each of `machines`; empty without any. Takes about 2 s.

    Raises FleetError if a probe cannot be run or does not begin in time.
    """
    if not machines:
        return ()
    nodes = {HERE: (HERE_NODE,), **{machine.name: machine.nodes for machine in machines}}
    flows: list[CalibrationFlow] = []
    for place, (first, *_) in enumerate(nodes.values()):
        at_s = round(place * EVERY_S / len(nodes), 6)
        ends = ((NET, first, fleet.address(first)), (first, NET, fleet.gateway(first)))
        flows += [
            CalibrationFlow(2 * place + way, first, DELAY, *end, at_s, EVERY_S, COUNT) for way, end in enumerate(ends)
        ]
    schedule = CalibrationSchedule(tuple(flows), COUNT * EVERY_S + AFTER_S)
    came = run_schedule(schedule, run_in_node)
    return tuple(
        _clock(name, own, came[2 * place], came[2 * place + 1]) for place, (name, own) in enumerate(nodes.items())
    )


def ahead_ns(clocks: Sequence[MachineClock]) -> Mapping[str, int]:
    """By node how far its clock is ahead of that of `net`, ns."""
    return {node: round((clock.ahead_ms or 0.0) * 1e6) for clock in clocks for node in clock.nodes}


def _clock(machine: str, nodes: tuple[str, ...], out: FlowResult, back: FlowResult) -> MachineClock:
    there, here = ([(row.received_ns - row.sent_ns) / 1e6 for row in came.rows] for came in (out, back))
    if not there or not here:
        return MachineClock(machine, nodes, None, None)
    return MachineClock(machine, nodes, round(median(there) + median(here), 3), round((min(there) - min(here)) / 2, 3))
