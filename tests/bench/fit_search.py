"""Searches by bisection for the rates at which a profile loses what the thesis lost, each simulated by frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

from net.link_plan import LinkPlan
from testbed.plan.fleets import standard_fleet
from tests.bench.fit_calls import unanswered, with_calls
from tests.bench.fit_simulation import DOWN, Crossed, Losses, Offered, finish, losses, to_cloud
from tests.bench.fit_streams import Streams, load_of

ONE_UAV, SIX_UAVS = (0.08, 0.15), (0.20, 0.28)
"""Shares that the thesis lost: of states with one UAV, of packets with six."""
ONE_UAV_MEAN, SIX_UAVS_MEAN = (8 + 14 + 15 + 12 + 15) / 500, (28 + 20 + 21 + 20) / 400
SETTLED_NS = 5_000_000_000
"""Frames sent before this do not count: queues fill in that time."""
CALL_EVERY_S = 1.0
AIR_STEP_BPS, WAN_STEP_BPS = 1_000, 10_000
Range = tuple[int, int]
"""The lowest and the highest rate that meet a target."""


@dataclass(frozen=True)
class Point:
    """The results of a pair of rates; `calls` is the share of calls without an answer in time."""

    air_bps: int
    wan_bps: int | None
    losses: Losses
    calls: float


@dataclass(frozen=True)
class Fit:
    """Rates for one set of streams.

    air       meets the states' loss of each drone alone
    wan       meets, with the fitted air, the loss of six drones' frames end to end
    wan_wire  meets that loss of frames over all links
    one, six  the results of the fitted rates, without and with a rate on the wan
    wire      the results of the middle of `wan_wire`
    """

    air: Range
    wan: Range
    wan_wire: Range
    one: Point
    six: Point
    wire: Point


class Trial:
    """One recording of six drones on a profile's links, with other rates."""

    def __init__(self, streams: Streams, links: Mapping[str, LinkPlan], seed: int) -> None:
        self.load_bps = round(sum(load_of(stream).kbit_s for stream in streams.values()) / len(streams) * 1000)
        self._links = links
        self._seed = seed
        self._calls = with_calls(streams, links, CALL_EVERY_S, SETTLED_NS, seed)
        self._offered = Offered(self._calls.streams, standard_fleet().fogs)
        self._to_cloud = cache(self._cross_to_cloud)
        self.at = cache(self._at)

    def _cross_to_cloud(self, air_bps: int) -> dict[str, Crossed]:
        return to_cloud(self._offered, with_rates(self._links, air_bps, None), self._seed)

    def _at(self, air_bps: int, wan_bps: int | None = None) -> Point:
        """Simulate rates; without one on the wan the drones do not interact: it is one UAV, six times."""
        crossed = finish(self._offered, self._to_cloud(air_bps), with_rates(self._links, air_bps, wan_bps), self._seed)
        found = losses(self._offered, crossed, SETTLED_NS)
        return Point(air_bps, wan_bps, found, unanswered(self._calls, self._offered, crossed))


def fit(trial: Trial) -> Fit:
    """Fit the air to the thesis's mean loss of states, then the wan to its mean loss with six UAVs."""
    bounds = (trial.load_bps // 2, trial.load_bps * 5 // 4)

    def most(air_bps: int) -> float:
        return max(trial.at(air_bps).losses.drones.values())

    def least(air_bps: int) -> float:
        return min(trial.at(air_bps).losses.drones.values())

    def mean(air_bps: int) -> float:
        return trial.at(air_bps).losses.end_to_end

    air_bps = lowest(mean, ONE_UAV_MEAN, bounds, AIR_STEP_BPS)
    air = (
        lowest(most, ONE_UAV[1], bounds, AIR_STEP_BPS),
        lowest(least, ONE_UAV[0], bounds, AIR_STEP_BPS) - AIR_STEP_BPS,
    )
    wan, wan_bps = wan_for(trial, air_bps, lambda point: point.losses.end_to_end)
    wan_wire, _ = wan_for(trial, air_bps, lambda point: point.losses.wire)
    return Fit(air, wan, wan_wire, trial.at(air_bps), trial.at(air_bps, wan_bps), trial.at(air_bps, sum(wan_wire) // 2))


def wan_for(trial: Trial, air_bps: int, loss: Callable[[Point], float]) -> tuple[Range, int]:
    """The wan's rates that meet the loss of six UAVs, and the one nearest to its mean."""
    bounds = (trial.load_bps, trial.load_bps * 8)

    def share(wan_bps: int) -> float:
        return loss(trial.at(air_bps, wan_bps))

    low, beyond, best = (
        lowest(share, wanted, bounds, WAN_STEP_BPS) for wanted in (SIX_UAVS[1], SIX_UAVS[0], SIX_UAVS_MEAN)
    )
    return (low, beyond - WAN_STEP_BPS), best


def lowest(share: Callable[[int], float], wanted: float, bounds: Range, step: int) -> int:
    """The lowest rate, in whole steps between the bounds, that loses `wanted` or less; more is lost at lower rates."""
    low, high = bounds[0] // step, -(-bounds[1] // step)
    while low < high:
        middle = (low + high) // 2
        if share(middle * step) <= wanted:
            high = middle
        else:
            low = middle + 1
    return low * step


def with_rates(links: Mapping[str, LinkPlan], air_bps: int, wan_bps: int | None) -> dict[str, LinkPlan]:
    """The profile's links with other rates on the way up; None: no rate."""
    found = dict(links)
    for name, link in links.items():
        if name.startswith("air:") and name.endswith(":up"):
            found[name] = replace(link, rate_bps=air_bps)
    queue = links[DOWN].queue_packets if wan_bps is not None else None
    found[DOWN] = replace(links[DOWN], rate_bps=wan_bps, queue_packets=queue)
    return found
