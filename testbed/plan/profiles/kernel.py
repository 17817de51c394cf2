"""A plan as `ip` and `tc` commands for a kernel that has netem: two stages for each directed link.

A frame on link S>D enters `net` on its interface towards S. Its destination determines the next hop, and so the link. A
filter sets the link's number as skb mark and redirects the frame to the first stage:

- **rate**: one IFB device, `rate`, for all links. Its HTB separates them by class; if both directions share a rate, a
  common parent class does the sharing. In each class a netem with only `rate` and `limit` sends one frame after the
  other. It is the link's queue: only frames that wait for the rate are in it, and those it drops are the queue's loss.
  (A pfifo in the class would leave the rate to HTB's tokens, by which a frame leaves before its own sending time.)
- Routing then takes the frame to the interface towards D, where its mark leads to the second stage:
- **delay**: an IFB device of the link's own, with a netem for delay, jitter, loss, duplication, corruption, reordering.
  Frames that wait there are in no queue of the first stage. Each netem is alone on its device, because some kernels
  refuse a netem that duplicates together with others in one tree.

An IFB device returns a frame to where it was taken from, after the captures on the way in and before those on the way
out: the captures have what entered the link and what left it. ARP and frames for `net` itself match no filter. Netem
sorts frames by when they are due, so jitter alone would let them overtake each other; with a rate, here one at which a
full frame takes a microsecond, no frame is due before the one ahead of it.

Interfaces towards nodes are written `@uav1`: their names are only known inside `net`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import Any

from net.link_plan import LinkPlan

from ..topology import Topology
from .directed import Directed, directed_links, frames_in_flight
from .draws import link_seed
from .resolve import LinksPlan

RATE_DEVICE = "rate"
IN_ORDER_BPS = 10_000_000_000
"""The second stage's rate if order is kept; also the first stage's while an event lifts a link's rate."""
_FULL_FRAME = 1_514
_WAITING_FRAMES = 10_000
_BORROWER_BPS, _BORROWER_BURST = 8, 1

Words = tuple[str, ...]


@dataclass(frozen=True)
class LinkState:
    """A link's state from `at_s` on; `words` are the commands that set it from any other state."""

    at_s: float
    closed: bool
    words: tuple[Words, ...]


@dataclass(frozen=True)
class LinkCommands:
    """The commands of one link: its states from 0 on, and those that close it (`shut`).

    `queue` is the handle of the first stage's netem, None without one; `device` is the second stage's.
    """

    device: str
    queue: str | None
    states: tuple[LinkState, ...]
    shut: tuple[Words, ...]


@dataclass(frozen=True)
class Commands:
    """Argument lists: `begin` before the first frame, `timed` at their seconds after the start, `end` after the last.

    `links` has the changes of `timed` by link, and more, for changes by hand in between.
    """

    begin: tuple[Words, ...]
    timed: tuple[tuple[float, Words], ...]
    end: tuple[Words, ...]
    links: Mapping[str, LinkCommands] = field(default_factory=dict)

    def to_data(self) -> dict[str, Any]:
        """The commands for JSON: `begin` and `end` are lists of words, `timed` has pairs of seconds and words."""
        return {
            "begin": [list(words) for words in self.begin],
            "timed": [[at_s, list(words)] for at_s, words in self.timed],
            "end": [list(words) for words in self.end],
            "links": {name: asdict(link) for name, link in self.links.items()},
        }


def commands_of(plan: LinksPlan, topology: Topology, always: bool = False) -> Commands:
    """The commands that shape the plan's links; with `always` every link has its stages, even without figures."""
    links = directed_links(plan, topology, always)
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
    return Commands(
        tuple(begin), tuple(timed), tuple(end), {link.name: _link_commands(link, plan.seed) for link in links}
    )


def change_words(
    plan: LinksPlan, topology: Topology, name: str, link_plan: LinkPlan, closed: bool
) -> tuple[Words, ...]:
    """The commands that give the directed link `name` other figures, in a run whose links were made with `always`.

    Both directions of a shared rate must be changed. Raises KeyError for a link that the plan does not have.
    """
    link = {each.name: each for each in directed_links(plan, topology, always=True)}[name]
    other = replace(link, states=(*link.states, (0.0, link_plan, closed)))
    return _words_of(other, len(other.states) - 1, link_seed(plan.seed, name, f"netem by hand {link_plan}"))


def _link_commands(link: Directed, seed: int) -> LinkCommands:
    states = [
        LinkState(at_s, closed, _words_of(link, step, _seed_of(link, step, seed)))
        for step, (at_s, _, closed) in enumerate(link.states)
    ]
    at_s, steady, _ = link.states[0]
    shut = replace(link, states=((at_s, steady, True), *link.states[1:]))
    words = (_netem("change", shut, 0, link_seed(seed, link.name, "netem shut")),)
    return LinkCommands(link.device, _queue_handle(link) if link.has_rate else None, tuple(states), words)


def _words_of(link: Directed, step: int, seed: int) -> tuple[Words, ...]:
    return (*_rate_stage("change", link, link.states[step][1]), _netem("change", link, step, seed))


def beyond(topology: Topology, source: str, first: str) -> list[str]:
    """The nodes that `source` reaches over its neighbour `first`, including that."""
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
    """The class, its parent if the rate is shared (made with the first of the two), and the sending queue."""
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
    limit = state.queue_packets or frames_in_flight(state)
    stage = f"dev {RATE_DEVICE} parent {leaf} handle {_queue_handle(link)} netem"
    yield _tc(f"qdisc {verb} {stage} limit {limit} rate {rate_bps}bit")


def _htb(verb: str, parent: str, classid: str, own_bps: int, ceiling_bps: int) -> Words:
    """An HTB class with tokens for one frame and 20 ms: HTB counts a frame as it leaves, after netem's sending time.

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
    yield _netem("add", link, 0, _seed_of(link, 0, seed))


def _netem(verb: str, link: Directed, step: int, seed: int) -> Words:
    """The second stage in one of the link's states."""
    return _tc(f"qdisc {verb} dev {link.device} root handle 1: netem {_impairments(link, step)} seed {seed}")


def _seed_of(link: Directed, step: int, seed: int) -> int:
    """The seed of a state; each has its own, because the same seed would repeat its random numbers."""
    return link_seed(seed, link.name, f"netem {step}")


def _queue_handle(link: Directed) -> str:
    return f"{0x200 + link.number:x}:"


def _impairments(link: Directed, step: int) -> str:
    """netem's options. A change keeps corruption and rate unless they are given, so they always are.

    A closed link does not duplicate: netem would pass on one copy of a frame that is both lost and duplicated.
    """
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
    words += [f"duplicate {_percent(state.duplicate)}"] if state.duplicate and not closed else []
    if link.has_corruption:
        words.append(f"corrupt {_percent(state.corrupt)}")
    if link.has_jitter and not state.reordering:
        words.append(f"rate {IN_ORDER_BPS}bit")
    return " ".join(words)


def _filters(link: Directed, topology: Topology) -> Iterator[Words]:
    """The filters of a link. In: by destination, one filter per address beyond the link. Out: by the mark set then."""
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
            yield at_s, _netem("change", link, step, _seed_of(link, step, seed))


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
