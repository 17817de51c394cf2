"""A plan as `ip` and `tc` commands for a kernel that has netem: two stages for each directed link.

A frame that enters link S>D comes into `net` on its interface towards S. There its destination tells which link it
takes, since the next hop does; a filter writes the link's number on it (skb mark) and hands it to the first stage:

- **rate**: one IFB device, `rate`, for all links. Its HTB parts them by class, and where both directions share a rate a
  common parent class does the sharing. In each class a netem with nothing but `rate` and `limit` sends one frame after
  the other and is the link's queue: only what waits for the rate is in it, and what it drops is the queue's loss.
  (A pfifo in the class would leave the rate to HTB's tokens, by which a frame leaves before its own sending time.)
- The frame goes on through routing, to the interface towards D, where its number leads to the second stage:
- **delay**: an IFB device of the link's own, with a netem for delay, jitter, loss, duplication, corruption, reordering.
  What waits there waits in no queue of the first stage. Each is alone on its device because some kernels refuse a
  netem that duplicates beside others in one tree.

An IFB device hands a frame back to where it was taken from, behind the captures on its way in and before those on its
way out: the captures see what entered the link and what left it. ARP and what is meant for `net` itself match no
filter. Netem orders frames by when they are due, so that jitter alone would let them overtake each other; with a rate,
here one that costs a full frame a microsecond, no frame is due before the one ahead of it.

Interfaces towards nodes are written `@uav1`: their names are only known inside `net`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

from ..topology import Topology
from .draws import link_seed
from .reading import DIRECTIONS
from .resolve import EventPlan, LinkPlan, Plan

RATE_DEVICE = "rate"
IN_ORDER_BPS = 10_000_000_000
"""The second stage's rate where order is kept; also the first one's while an event lifts a link's rate."""
SMALLEST_FRAME_BITS = 60 * 8
MOST_FRAMES_S = 100_000
"""What an unlimited link is expected to carry at most: an explicit limit has to be some number."""
_SPARE_FRAMES = 1_000
_WIDEST_JITTER = 4
"""netem's tables reach four deviations from the mean."""
_FULL_FRAME = 1_514
_WAITING_FRAMES = 10_000
_BORROWER_BPS, _BORROWER_BURST = 1_000, 100

Words = tuple[str, ...]


@dataclass(frozen=True)
class Directed:
    """A directed link that is shaped: its number (mark and HTB class), ends, and the devices and states it has."""

    name: str
    number: int
    source: str
    destination: str
    device: str
    states: tuple[tuple[float, LinkPlan, bool], ...]
    """(from when on in seconds, figures, whether it is closed), the first at 0."""

    @cached_property
    def has_rate(self) -> bool:
        return any(state.rate_bps is not None for _, state, _ in self.states)

    @cached_property
    def has_jitter(self) -> bool:
        return any(state.jitter_us for _, state, _ in self.states)

    @cached_property
    def has_corruption(self) -> bool:
        return any(state.corrupt for _, state, _ in self.states)

    @cached_property
    def limit(self) -> int:
        """Room for all that can be on its way at any time: a frame that found none would be lost by mistake."""
        return max(_in_flight(state) for _, state, _ in self.states)

    @property
    def is_shared(self) -> bool:
        return self.states[0][1].shared_with is not None


@dataclass(frozen=True)
class Commands:
    """Argument lists: `begin` before the first frame, `timed` at their seconds since then, `end` after the last."""

    begin: tuple[Words, ...]
    timed: tuple[tuple[float, Words], ...]
    end: tuple[Words, ...]

    def to_data(self) -> dict[str, Any]:
        """As JSON has it: `begin` and `end` lists of words, `timed` pairs of seconds and words."""
        return {
            "begin": [list(words) for words in self.begin],
            "timed": [[at_s, list(words)] for at_s, words in self.timed],
            "end": [list(words) for words in self.end],
        }


def commands_of(plan: Plan, topology: Topology) -> Commands:
    """What shapes the plan's links; nothing at all where it shapes none."""
    links = directed_links(plan, topology)
    begin: list[Words] = []
    if any(link.has_rate for link in links):
        begin += [*_device(RATE_DEVICE), _tc("qdisc add dev rate root handle 1: htb")]
    ports = sorted({end for link in links for end in (link.source, link.destination)}, key=_order(topology).index)
    begin += [_tc(f"qdisc add dev @{port} clsact") for port in ports]
    timed: list[tuple[float, Words]] = []
    for link in links:
        begin += _rate_stage("add", link, link.states[0][1])
        begin += _delay_stage(link, plan.seed)
        begin += _filters(link, topology)
        timed += _changes(link, plan.seed)
    timed.sort(key=lambda change: change[0])
    devices = [*([RATE_DEVICE] if any(link.has_rate for link in links) else []), *(link.device for link in links)]
    end = [_tc(f"qdisc del dev @{port} clsact") for port in ports]
    end += [_ip(f"link del {device}") for device in devices]
    return Commands(tuple(begin), tuple(timed), tuple(end))


def directed_links(plan: Plan, topology: Topology) -> list[Directed]:
    """The links that are shaped at some time, numbered in the order of all links."""
    found = []
    for number, name in enumerate(plan.links, 1):
        states = tuple(_states(plan, name))
        if not any(state.is_shaped or closed for _, state, closed in states):
            continue
        base, _, direction = name.rpartition(":")
        ends = next((each.lower, each.upper) for each in topology.links if each.name == base)
        source, destination = ends if direction == DIRECTIONS[0] else ends[::-1]
        kind, _, node = base.partition(":")
        found.append(Directed(name, number, source, destination, f"{kind[:4]}-{node}-{direction}", states))
    return found


def _states(plan: Plan, name: str) -> Iterator[tuple[float, LinkPlan, bool]]:
    """A link's figures over time: later events stand above earlier ones for as long as they last."""
    base = asdict(plan.links[name])
    ahead = deque(event for event in plan.events if event.link == name)
    times = {0.0} | {event.at_s for event in ahead} | {_end_of(event) for event in ahead}
    lasting: list[EventPlan] = []
    last: tuple[LinkPlan, bool] | None = None
    for at_s in sorted(times):
        while ahead and ahead[0].at_s <= at_s:
            lasting.append(ahead.popleft())
        lasting = [event for event in lasting if at_s < _end_of(event)]
        figures: dict[str, Any] = dict(base)
        for event in lasting:
            figures |= event.change
        closed = bool(figures.pop("closed", False))
        state = (LinkPlan(**figures), closed)
        if state != last:
            yield at_s, *state
        last = state


def _end_of(event: EventPlan) -> float:
    return round(event.at_s + event.for_s, 6)


def beyond(topology: Topology, source: str, first: str) -> list[str]:
    """The nodes that `source` reaches by its neighbour `first`, which is one of them."""
    seen, ahead = {source}, [first]
    while ahead:
        here = ahead.pop()
        seen.add(here)
        for link in topology.links:
            for one, other in ((link.lower, link.upper), (link.upper, link.lower)):
                if one == here and other not in seen:
                    ahead.append(other)
    return [name for name in _order(topology) if name in seen - {source}]


def _rate_stage(verb: str, link: Directed, state: LinkPlan) -> Iterator[Words]:
    """The class, its parent where the rate is shared (made with the first of both), and the sending queue."""
    if not link.has_rate:
        return
    rate_bps = state.rate_bps or IN_ORDER_BPS
    leaf, parent, own_bps = f"1:{link.number:x}", "1:", rate_bps
    if link.is_shared:
        first = link.number - (link.number + 1) % 2
        parent, own_bps = f"1:{0x100 + first:x}", _BORROWER_BPS
        if link.number == first:
            yield _htb(verb, "1:", parent, rate_bps, rate_bps)
    yield _htb(verb, parent, leaf, own_bps, rate_bps)
    limit = state.queue_packets or _in_flight(state)
    handle = f"{0x200 + link.number:x}:"
    yield _tc(f"qdisc {verb} dev {RATE_DEVICE} parent {leaf} handle {handle} netem limit {limit} rate {rate_bps}bit")


def _htb(verb: str, parent: str, classid: str, own_bps: int, ceiling_bps: int) -> Words:
    """Tokens for one frame and 20 ms: HTB counts a frame when it goes, netem has let it wait for its sending before.

    A class that only borrows has hardly any tokens of its own, so that two of them have no more than their parent.
    """
    ceiling_burst = _FULL_FRAME + ceiling_bps // 400
    burst = ceiling_burst if own_bps == ceiling_bps else _BORROWER_BURST
    return _tc(
        f"class {verb} dev {RATE_DEVICE} parent {parent} classid {classid} htb rate {own_bps}bit burst {burst}"
        f" ceil {ceiling_bps}bit cburst {ceiling_burst} quantum {_FULL_FRAME}"
    )


def _delay_stage(link: Directed, seed: int) -> Iterator[Words]:
    yield from _device(link.device)
    yield _netem("add", link, 0, seed)


def _netem(verb: str, link: Directed, step: int, seed: int) -> Words:
    """The second stage at one of the link's states, each with a seed: the same one would start its numbers anew."""
    words = f"qdisc {verb} dev {link.device} root handle 1: netem {_impairments(link, step)}"
    return _tc(f"{words} seed {link_seed(seed, link.name, f'netem {step}')}")


def _impairments(link: Directed, step: int) -> str:
    """What netem is told; a change leaves corruption and rate as they are unless they are named, so they always are."""
    _, state, closed = link.states[step]
    words = [f"limit {link.limit}"]
    if state.delay_us:
        words.append(f"delay {state.delay_us}us")
        if state.jitter_us:
            words.append(f"{state.jitter_us}us")
            words += [f"distribution {state.distribution}"] if state.distribution != "uniform" else []
    if state.reorder:
        words.append(f"reorder {_percent(state.reorder)}")
    loss = 1.0 if closed else state.loss
    words += [f"loss {_percent(loss)}"] if loss else []
    words += [f"duplicate {_percent(state.duplicate)}"] if state.duplicate else []
    if link.has_corruption:
        words.append(f"corrupt {_percent(state.corrupt)}")
    if link.has_jitter and not state.reordering:
        words.append(f"rate {IN_ORDER_BPS}bit")
    return " ".join(words)


def _filters(link: Directed, topology: Topology) -> Iterator[Words]:
    """In: by destination, one filter an address beyond the link. Out: by the number that was written then."""
    addresses = {node.name: node.address for node in topology.nodes}
    to_rate = f" priority 1:{link.number:x}" if link.has_rate else ""
    then = f"pipe action mirred egress redirect dev {RATE_DEVICE}" if link.has_rate else "pass"
    for node in beyond(topology, link.source, link.destination):
        yield _tc(
            f"filter add dev @{link.source} ingress protocol ip prio 1 u32 match ip dst {addresses[node]}/32"
            f" action skbedit{to_rate} mark {link.number} {then}"
        )
    yield _tc(
        f"filter add dev @{link.destination} egress protocol ip prio 1 handle {link.number} fw"
        f" action mirred egress redirect dev {link.device}"
    )


def _changes(link: Directed, seed: int) -> Iterator[tuple[float, Words]]:
    for step, (before, (at_s, state, _)) in enumerate(pairwise(link.states), 1):
        if (state.rate_bps, state.queue_packets) != (before[1].rate_bps, before[1].queue_packets):
            yield from ((at_s, words) for words in _rate_stage("change", link, state))
        if _impairments(link, step) != _impairments(link, step - 1):
            yield at_s, _netem("change", link, step, seed)


def _in_flight(state: LinkPlan) -> int:
    frames_s = MOST_FRAMES_S if state.rate_bps is None else -(-state.rate_bps // SMALLEST_FRAME_BITS)
    longest_us = state.delay_us + _WIDEST_JITTER * state.jitter_us
    return _SPARE_FRAMES + -(-min(frames_s, MOST_FRAMES_S) * longest_us // 1_000_000)


def _percent(share: float) -> str:
    return f"{share * 100:.7f}".rstrip("0").rstrip(".") + "%"


def _device(name: str) -> list[Words]:
    return [_ip(f"link add {name} type ifb"), _ip(f"link set {name} txqueuelen {_WAITING_FRAMES} up")]


def _order(topology: Topology) -> Sequence[str]:
    return [node.name for node in topology.nodes]


def _tc(words: str) -> Words:
    return ("tc", *words.split())


def _ip(words: str) -> Words:
    return ("ip", *words.split())
