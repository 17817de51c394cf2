"""Commands on the profile's links: what they add to a drone's stream, and which calls end without their answer.

A call is as in MAVSDK: the command is sent again every half second until an answer arrives, and the call is given up
two seconds after it began. Commands travel down, where no rate is set; their answers travel up, between the states.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass

from net.link_plan import LinkPlan
from testbed.plan.fleets import standard_fleet
from tests.bench.fit_simulation import DOWN, Crossed, Moving, Offered, cross
from tests.bench.fit_streams import Frame, Streams

ANSWER = "COMMAND_ACK"
COMMAND_BYTES, ANSWER_BYTES = 86, 64
AGAIN_NS, LIMIT_NS = 500_000_000, 2_000_000_000
"""MAVSDK's default timeout and three repetitions; with a round trip of more than a second all are sent."""
COPIES = 4


@dataclass(frozen=True)
class Calls:
    """Streams with the answers to calls among them."""

    streams: Streams
    limits_ns: Mapping[int, tuple[tuple[int, int], ...]]
    """For each drone, for each answer in its stream in order: the call's number, and when that is given up."""
    begun: int
    arrived: int
    """Calls of which a copy reached the drone."""


def with_calls(streams: Streams, links: Mapping[str, LinkPlan], every_s: float, since_ns: int, seed: int) -> Calls:
    """Add a call to each drone about every `every_s` seconds from `since_ns` on, at random times."""
    found: dict[int, tuple[Frame, ...]] = {}
    limits: dict[int, tuple[tuple[int, int], ...]] = {}
    begun = arrived = 0
    for drone, stream in streams.items():
        draw = random.Random(f"{seed}/calls/{drone}")
        begin_ns, end_ns = since_ns, stream[-1].t_ns - 2 * LIMIT_NS
        copies: Moving = []
        begins = []
        while (begin_ns := begin_ns + round(every_s * 1e9 * draw.uniform(0.5, 1.5))) < end_ns:
            copies += [(begin_ns + copy * AGAIN_NS, COMMAND_BYTES, len(begins)) for copy in range(COPIES)]
            begins.append(begin_ns)
        at_drone = _down(drone, sorted(copies), links, seed)
        begun += len(begins)
        arrived += len({call for _, _, call in at_drone})
        limits[drone] = tuple((call, begins[call] + LIMIT_NS) for _, _, call in at_drone)
        answers = [Frame(t_ns, ANSWER_BYTES, ANSWER) for t_ns, _, _ in at_drone]
        found[drone] = tuple(sorted([*stream, *answers], key=lambda frame: frame.t_ns))
    return Calls(found, limits, begun, arrived)


def unanswered(calls: Calls, offered: Offered, crossed: Mapping[str, Crossed]) -> float:
    """The share of calls that were given up before an answer came."""
    come_ns = {number: t_ns for t_ns, _, number in crossed[DOWN].left}
    answered = set()
    for drone, frames in offered.by_drone.items():
        answers = [number for _, _, number in frames if offered.kinds[number] == ANSWER]
        for number, (call, limit_ns) in zip(answers, calls.limits_ns[drone], strict=True):
            if come_ns.get(number, limit_ns) < limit_ns:
                answered.add((drone, call))
    return 1 - len(answered) / calls.begun


def _down(drone: int, copies: Moving, links: Mapping[str, LinkPlan], seed: int) -> Moving:
    """The copies that arrive at the drone from the ground station."""
    fog = next(fog for fog, drones in standard_fleet().fogs.items() if drone in drones)
    for name in ("wan:gs:up", f"backhaul:fog{fog}:down", f"air:uav{drone}:down"):
        copies = cross(name, links[name], copies, seed).left
    return copies
