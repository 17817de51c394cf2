"""Turns a plan into the probes that each node sends: for the delay on all links at once, then for the rates.

Rates. A link that is offered 1.25 times its rate with a full queue accepts a frame whenever it has sent one, so the
frames that arrive were *sent* at the link's rate. Delay and jitter do not affect that: a fifteenth of a second is
enough, where a rate taken from arrival times needs eighty jitters. The queue is filled by a burst that is larger than
it, since the link sends while the burst arrives. Slow links are probed at the same time, fast ones one after the other,
a shared medium one direction after the other. If a queue takes too long to fill, a burst that fits into it is sent
instead, and the rate is taken from the arrival times.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from net.link_plan import SLOT_JITTERS, LinkPlan

from ...plan.profiles.directed import WIDEST_JITTER
from ...plan.profiles.resolve import LinksPlan
from ...plan.topology import Topology
from .expected import arriving

SMALLEST_FRAME, LARGEST_FRAME = 62, 1_514
"""Bytes of an Ethernet frame with an empty probe, and of a full one."""
DELAY_SLOTS = 50
SHORTEST_S, LONGEST_S = 1.0, 8.0
"""Delay probes last 50 of jitter's slots within these bounds: some 30 independent values."""
FEWEST_PROBES = 12
CLOSEST_S = 0.025
OFFER = 1.25
OVERFILL, SPARE_FRAMES = 1.5, 5
RATE_S = 1.0
"""How long a rate probe may take, including filling the queue, if 40 small frames fit into that time."""
FEWEST_FRAMES, ENOUGH_FRAMES = 40, 150
BRIEFEST_S = 0.06
"""Twice and four times that where it is probed again: a busy computer's pauses at the two ends weigh less then."""
SMALLEST_RATE_FRAME = 80
LONGEST_FILL_S = 3.0
UNSTEADY_S = 0.004
"""How late a sender may be; a queue that is empty sooner cannot be kept full."""
FAST_BPS = 5_000_000
FASTEST_BPS = 200_000_000
"""Above it are 20,000 full frames per second, with which a machine that also shapes and captures may not keep up."""
LOSSIEST = 0.9
PAUSE_S = 0.03
LOAD_LOSSES, LOAD_FRAMES = 8, (2_000, 8_000)
"""As many frames as lose 8, at which a count of none is outside the interval, within these bounds."""
LOAD_FRAMES_S, LOAD_SHARE, LONGEST_LOAD_S = 6_000, 0.8, 20.0
"""Frames per second on all links together; the share of each link's rate; the longest time."""

DELAY, RATE, LOAD = "delay", "rate", "load"
DOWN = "down"


@dataclass(frozen=True)
class CalibrationFlow:
    """Probes of one directed link. `overfills`: the rate is taken from send times, not from arrival times."""

    number: int
    link: str
    purpose: str
    source: str
    destination: str
    address: str
    at_s: float
    every_s: float
    count: int
    frame_bytes: int = SMALLEST_FRAME
    burst: int = 1
    overfills: bool = False

    @property
    def sent_s(self) -> float:
        """When the last probe is sent."""
        return self.at_s + max(0, self.count - self.burst) * self.every_s

    def to_data(self) -> dict[str, Any]:
        """The flow in the input of `net.probe`."""
        return {
            "flow": self.number, "to": self.address, "at_s": self.at_s, "burst": self.burst, "every_s": self.every_s,
            "count": self.count, "bytes": self.frame_bytes, "timed": self.purpose != LOAD,
        }  # fmt: skip


@dataclass(frozen=True)
class CalibrationSchedule:
    """All flows, the time by which the last frame has arrived, and by (link, figure) why it is not probed."""

    flows: tuple[CalibrationFlow, ...]
    length_s: float
    unprobed: Mapping[tuple[str, str], str] = field(default_factory=dict)

    @property
    def nodes(self) -> tuple[str, ...]:
        """Every node that sends or receives."""
        return tuple(dict.fromkeys(node for flow in self.flows for node in (flow.source, flow.destination)))

    def of_node(self, node: str, run: int, begin_ns: int) -> dict[str, Any]:
        """One node's part, the input of `net.probe`."""
        flows = [flow.to_data() for flow in self.flows if flow.source == node]
        return {"run": run, "begin_ns": begin_ns, "end_s": self.length_s, "flows": flows}


def make_schedule(
    plan: LinksPlan, topology: Topology, closed: Mapping[str, str], only: frozenset[str], again: int = 0
) -> CalibrationSchedule:
    """Schedule probes of the links in `only`; `closed` has, by link as sense:uav1, why it passes nothing.

    `again` is how often they were probed before.
    """
    unprobed = dict(_unprobed(plan, closed))
    wanted = [name for name in plan.links if name in only and (name, DELAY) not in unprobed]
    flows: list[CalibrationFlow] = []
    for place, name in enumerate(wanted):
        ends = _ends(topology, name)
        flows.append(_delay_flow(plan.links[name], ends, len(flows), name, place / max(1, len(wanted))))
    free_s = max((_arrived_s(flow, plan.links[flow.link]) for flow in flows), default=0.0)
    rated = [name for name in wanted if (name, RATE) not in unprobed]
    for group in _rate_groups(plan, rated):
        last_s = free_s
        for name in group:
            briefest_s = BRIEFEST_S * 2**again
            ends = _ends(topology, name)
            flow = _rate_flow(plan.links[name], ends, len(flows), name, free_s + PAUSE_S, briefest_s)
            flows.append(flow)
            last_s = max(last_s, flow.sent_s + _drain_s(flow, plan.links[name]))
        free_s = last_s
    length_s = max((_arrived_s(flow, plan.links[flow.link]) for flow in flows), default=0.0)
    return CalibrationSchedule(tuple(flows), round(length_s, 3), unprobed)


def make_load(plan: LinksPlan, topology: Topology, closed: Mapping[str, str]) -> CalibrationSchedule:
    """Schedule frames on every lossy link, so that the shaper's counters show the loss; the frames measure nothing."""
    wanted = [name for name, link in plan.links.items() if link.loss and not _closed(name, closed)]
    flows: list[CalibrationFlow] = []
    for number, name in enumerate(wanted):
        link = plan.links[name]
        ways = 1 if link.shared_with is None else 2
        every_s = max(len(wanted) / LOAD_FRAMES_S, ways * _sending_s(link, SMALLEST_FRAME) / LOAD_SHARE)
        fewest, most = LOAD_FRAMES
        count = min(max(fewest, min(most, math.ceil(LOAD_LOSSES / link.loss))), int(LONGEST_LOAD_S / every_s))
        at_s = round(every_s * number / len(wanted), 6)
        flows.append(CalibrationFlow(number, name, LOAD, *_ends(topology, name), at_s, round(every_s, 9), count))
    length_s = max((_arrived_s(flow, plan.links[flow.link]) for flow in flows), default=0.0)
    return CalibrationSchedule(tuple(flows), round(length_s, 3))


def _closed(name: str, closed: Mapping[str, str]) -> str | None:
    return closed.get(name.rpartition(":")[0]) or closed.get(name)


def _unprobed(plan: LinksPlan, closed: Mapping[str, str]) -> Iterator[tuple[tuple[str, str], str]]:
    for name, link in plan.links.items():
        why = _closed(name, closed)
        if why is None and arriving(link) < 1 - LOSSIEST:
            why = f"loses {1 - arriving(link):.0%} of what is sent"
        if why is not None:
            yield (name, DELAY), why
        rate_why = why or _rate_unprobed(link)
        if rate_why is not None:
            yield (name, RATE), rate_why


def _rate_unprobed(link: LinkPlan) -> str | None:
    if link.rate_bps is None or link.queue_packets is None:
        return "unlimited"
    if link.rate_bps > FASTEST_BPS:
        return f"faster than {FASTEST_BPS // 1_000_000} Mbit/s"
    if _kept_s(link) < UNSTEADY_S:
        return f"its queue is empty after {_kept_s(link) * 1e3:.1f} ms, sooner than a sender can keep it full"
    return None


def _kept_s(link: LinkPlan) -> float:
    """How long the link needs to send a full queue of the frames with which it is probed."""
    assert link.queue_packets is not None
    size, _ = _rate_size(link) if _can_fill(link) else (LARGEST_FRAME, 0)
    return max(0, link.queue_packets - 1) * _sending_s(link, size)


def _ends(topology: Topology, name: str) -> tuple[str, str, str]:
    """A directed link's source, its destination, and the destination's address."""
    source, destination = topology.ends[name]
    return source, destination, next(node.address for node in topology.nodes if node.name == destination)


def _delay_flow(link: LinkPlan, ends: tuple[str, str, str], number: int, name: str, phase: float) -> CalibrationFlow:
    """Delay probes, far enough apart that none overtakes another or waits for another to be sent."""
    jitter_s = link.jitter_us / 1e6
    sending_s = _sending_s(link, SMALLEST_FRAME)
    every_s = max(CLOSEST_S, 3 * jitter_s, 4 * sending_s)
    steady_s = DELAY_SLOTS * SLOT_JITTERS[link.distribution] * jitter_s
    lasts_s = max(SHORTEST_S, min(LONGEST_S, steady_s), FEWEST_PROBES * every_s)
    count = math.ceil(lasts_s / every_s / arriving(link))
    if link.shared_with is not None:  # the other direction's probes are sent halfway between
        phase = 0.5 * name.endswith(f":{DOWN}")
    return CalibrationFlow(number, name, DELAY, *ends, round(phase * every_s, 6), round(every_s, 6), count)


def _rate_groups(plan: LinksPlan, names: list[str]) -> Iterator[list[str]]:
    """Groups of links that are probed at the same time."""
    slow = [name for name in names if (plan.links[name].rate_bps or 0) <= FAST_BPS]
    second = [name for name in slow if plan.links[name].shared_with in slow and name.endswith(f":{DOWN}")]
    for group in ([name for name in slow if name not in second], second):
        if group:
            yield group
    yield from ([name] for name in names if name not in slow)


def _rate_flow(
    link: LinkPlan, ends: tuple[str, str, str], number: int, name: str, at_s: float, briefest_s: float
) -> CalibrationFlow:
    assert link.queue_packets is not None
    at_s = round(at_s, 6)
    if not _can_fill(link):
        wanted = int(80 * link.jitter_us / 1e6 / _sending_s(link, SMALLEST_RATE_FRAME))
        count = min(link.queue_packets, max(FEWEST_FRAMES, min(wanted, 1_000)))
        return CalibrationFlow(number, name, RATE, *ends, at_s, 0.0, count, SMALLEST_RATE_FRAME, burst=count)
    size, frames = _rate_size(link)
    frames = max(frames, math.ceil(briefest_s / _sending_s(link, size)))
    every_s = _sending_s(link, size) / OFFER
    burst = math.ceil(OVERFILL * link.queue_packets) + SPARE_FRAMES
    count = burst + math.ceil(frames * OFFER)
    return CalibrationFlow(number, name, RATE, *ends, at_s, round(every_s, 9), count, size, burst, overfills=True)


def _can_fill(link: LinkPlan) -> bool:
    assert link.queue_packets is not None
    return link.queue_packets * _sending_s(link, SMALLEST_RATE_FRAME) <= LONGEST_FILL_S


def _rate_size(link: LinkPlan) -> tuple[int, int]:
    """The size of rate probes in bytes, as large as RATE_S allows, and how many frames the link sends meanwhile."""
    assert link.queue_packets is not None
    assert link.rate_bps is not None
    bits = RATE_S * link.rate_bps
    size = int(bits / 8 / (link.queue_packets + ENOUGH_FRAMES))
    size = max(SMALLEST_RATE_FRAME, min(LARGEST_FRAME, size))
    frames = int(bits / 8 / size) - link.queue_packets
    return size, max(FEWEST_FRAMES, min(ENOUGH_FRAMES, frames))


def _sending_s(link: LinkPlan, frame_bytes: int) -> float:
    return 0.0 if link.rate_bps is None else frame_bytes * 8 / link.rate_bps


def _drain_s(flow: CalibrationFlow, link: LinkPlan) -> float:
    """How long the link goes on sending after the last probe was sent to it."""
    waiting = min(flow.count, link.queue_packets or flow.count) if flow.purpose == RATE else 2
    return waiting * _sending_s(link, flow.frame_bytes)


def _arrived_s(flow: CalibrationFlow, link: LinkPlan) -> float:
    far_s = (link.delay_us + WIDEST_JITTER * link.jitter_us) / 1e6
    return flow.sent_s + _drain_s(flow, link) + far_s + 5 * PAUSE_S
