"""Streams through a profile's links, frame by frame and without I/O: the losses by place and by kind.

Each link has the plan's two stages: a rate with its queue, then random loss, delay and jitter. The first is exact, in
whole nanoseconds: a frame leaves when its last bit is sent, and one that finds `queue_packets` frames in the stage is
dropped. Jitter is the emulator's own process of time, so that the drones' frames meet in the same order as there.
"""

from __future__ import annotations

import random
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import TypeVar

from net.emulator.jitter import make_jitter
from net.link_plan import LinkPlan
from tests.bench.fit_streams import Streams

DOWN = "wan:gs:down"
"""From the cloud to the ground station: the last link of the drones' messages."""
_NS = 1_000_000_000
_Label = TypeVar("_Label", int, str)
Moving = list[tuple[int, int, int]]
"""Frames on their way: when each is here, its size in bytes, its number."""


@dataclass(frozen=True)
class Crossed:
    """One link's results, in frames; `left` are those that it passed on."""

    entered: int
    left: Moving
    queue: int
    random: int


@dataclass(frozen=True)
class Losses:
    """Shares of frames.

    end_to_end  sent by a drone and not arrived at the ground station / sent
    wire        entered a link and did not leave it / entered, over all links on the way
    drones      end to end, for each drone
    kinds       end to end, for each kind of message
    """

    sent: int
    end_to_end: float
    wire: float
    drones: Mapping[int, float]
    kinds: Mapping[str, float]


class Offered:
    """Streams as one numbered list of frames, and which links each crosses."""

    def __init__(self, streams: Streams, fleet: Mapping[int, Sequence[int]]) -> None:
        self.kinds: list[str] = []
        self.sent_ns: list[int] = []
        self.drones: list[int] = []
        self.fogs = {fog: tuple(d for d in drones if d in streams) for fog, drones in fleet.items()}
        self.by_drone: dict[int, Moving] = {}
        for drone, stream in streams.items():
            first = len(self.kinds)
            self.by_drone[drone] = [(frame.t_ns, frame.size, first + place) for place, frame in enumerate(stream)]
            self.kinds += [frame.kind for frame in stream]
            self.sent_ns += [frame.t_ns for frame in stream]
            self.drones += [drone] * len(stream)


def run(offered: Offered, links: Mapping[str, LinkPlan], seed: int) -> dict[str, Crossed]:
    """Simulate every link on the way to the ground station; returns them by name."""
    return finish(offered, to_cloud(offered, links, seed), links, seed)


def to_cloud(offered: Offered, links: Mapping[str, LinkPlan], seed: int) -> dict[str, Crossed]:
    """Simulate air and backhaul; returns them by name."""
    found: dict[str, Crossed] = {}
    for fog, drones in offered.fogs.items():
        names = [f"air:uav{drone}:up" for drone in drones]
        for name, drone in zip(names, drones, strict=True):
            found[name] = cross(name, links[name], offered.by_drone[drone], seed)
        if drones:
            name = f"backhaul:fog{fog}:up"
            found[name] = cross(name, links[name], merged(found[air].left for air in names), seed)
    return found


def finish(
    offered: Offered, crossed: Mapping[str, Crossed], links: Mapping[str, LinkPlan], seed: int
) -> dict[str, Crossed]:
    """Simulate the last link after the results of `to_cloud`; returns all."""
    together = merged(crossed[f"backhaul:fog{fog}:up"].left for fog, drones in offered.fogs.items() if drones)
    return {**crossed, DOWN: cross(DOWN, links[DOWN], together, seed)}


def merged(flows: Iterable[Moving]) -> Moving:
    """Merge flows in the order of time."""
    return sorted((frame for flow in flows for frame in flow), key=itemgetter(0))


def cross(name: str, link: LinkPlan, frames: Moving, seed: int) -> Crossed:
    """Send frames, in the order of time, through one link."""
    sent = send(frames, link.rate_bps, link.queue_packets)
    draw = random.Random(f"{seed}/{name}").random
    kept = [frame for frame in sent if draw() >= link.loss] if link.loss else sent
    jitter = make_jitter(link.distribution, link.jitter_us * 1000, link.reordering, seed, name)
    left = delay(kept, link.delay_us * 1000, jitter, not link.reordering)
    return Crossed(len(frames), left, len(frames) - len(sent), len(sent) - len(kept))


def send(frames: Moving, rate_bps: int | None, queue_packets: int | None) -> Moving:
    """The rate stage: when the last bit of each frame is sent; a frame that finds the queue full is left out."""
    if rate_bps is None:
        return frames
    leaving: deque[int] = deque()
    free_ns, sent = 0, []
    for now_ns, size, number in frames:
        while leaving and leaving[0] <= now_ns:
            leaving.popleft()
        if queue_packets is not None and len(leaving) >= queue_packets:
            continue
        free_ns = max(free_ns, now_ns) + size * 8 * _NS // rate_bps
        leaving.append(free_ns)
        sent.append((free_ns, size, number))
    return sent


def delay(frames: Moving, delay_ns: int, jitter: Callable[[int], int], keeps_order: bool) -> Moving:
    """The second stage: delay with the jitter of a frame's time, and in order never before the frame ahead of it."""
    left, last_ns = [], 0
    for now_ns, size, number in frames:
        due_ns = max(now_ns, now_ns + delay_ns + jitter(now_ns))
        if keeps_order:
            due_ns = last_ns = max(due_ns, last_ns)
        left.append((due_ns, size, number))
    return left if keeps_order else sorted(left, key=itemgetter(0))


def losses(offered: Offered, crossed: Mapping[str, Crossed], since_ns: int = 0) -> Losses:
    """The losses of frames sent from `since_ns` on: before that, queues still fill."""
    sent_ns = offered.sent_ns
    counted = [number for number, t_ns in enumerate(sent_ns) if t_ns >= since_ns]
    hops: Counter[str] = Counter()
    for name, link in crossed.items():
        hops[name.partition(":")[0]] += sum(sent_ns[number] >= since_ns for _, _, number in link.left)
    come = [number for _, _, number in crossed[DOWN].left if sent_ns[number] >= since_ns]
    entered, lost = len(counted) + hops["air"] + hops["backhaul"], len(counted) - len(come)
    return Losses(
        sent=len(counted),
        end_to_end=lost / len(counted),
        wire=lost / entered,
        drones=_shares(offered.drones, counted, come),
        kinds=_shares(offered.kinds, counted, come),
    )


def _shares(labels: Sequence[_Label], counted: Sequence[int], come: Sequence[int]) -> dict[_Label, float]:
    """By label, the share of numbers that did not arrive."""
    arrived = Counter(labels[number] for number in come)
    return {label: 1 - arrived[label] / sent for label, sent in Counter(labels[number] for number in counted).items()}
