"""The rounds of flows that both shapers get, each with its plan of links.

Flows that need many datagrams far apart run side by side on links of their own; a round of waiting costs the virtual
machine nothing. Where a delay is to be a sample of its distribution, datagrams are further apart than jitter lasts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from net.link_plan import EventPlan, LinkPlan
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.kernel import commands_of
from testbed.plan.profiles.reading import read_profile
from testbed.plan.profiles.resolve import LinksPlan, resolve
from testbed.plan.topology import Topology

NODES = ("gs", "cloud", "fog1", "uav1", "uav2", "uav3")
PROFILES = ("lte", "edge", "leo", "geo", "sik", "lossy", "thesis")
SEED = 7
SMALL, LARGE = 114, 1014
"""Bytes of Ethernet frames."""
ETHERNET_BYTES = 14
SAMPLE = 1500
"""The number of delays that represent a distribution: two samples of that size differ by a Kolmogorov-Smirnov distance
of 0.09 once in 100,000 pairs."""
APART_US = 101_300
"""More than two of the emulator's slots of 4 ms jitter: each delay is drawn independently."""
PROFILE_SAMPLE, PROFILE_APART_US = 200, 1_100_000


@dataclass(frozen=True)
class Flow:
    """Datagrams from a node to another, `every_us` apart, as Ethernet frames of `size` bytes; `name` is unique."""

    name: str
    source: str
    destination: str
    count: int
    every_us: int
    size: int = SMALL
    start_us: int = 0


@dataclass(frozen=True)
class Round:
    """A plan, and the flows that are sent under it."""

    name: str
    plan: LinksPlan
    flows: tuple[Flow, ...]


@dataclass(frozen=True)
class Feature:
    """A link's figures in a round, with the flow that shows them (from the link's lower end to its upper)."""

    name: str
    link: LinkPlan
    count: int
    every_us: int
    size: int = SMALL


def topology() -> Topology:
    """A ground station, the cloud, a fog and three drones of compose.yaml's."""
    return replace(standard_fleet(), fogs={1: (1, 2, 3)}).topology()


def rounds() -> list[Round]:
    """All rounds, in the order in which they are run."""
    return [
        *_of_features("jitter", JITTER),
        *_of_features("chance", CHANCE),
        *_of_features("rate", RATE),
        _shared(),
        _events(),
        *(_profile(name) for name in PROFILES),
    ]


JITTERED = {"delay_us": 40_000, "jitter_us": 4_000}
WIDE = {"delay_us": 40_000, "jitter_us": 10_000}
QUEUE = LinkPlan(rate_bps=1_000_000, queue_packets=20, delay_us=60_000)
JITTER = (
    Feature("delay", LinkPlan(delay_us=50_000), 300, 20_300),
    *(
        Feature(f"jitter {kind}", LinkPlan(**JITTERED, distribution=kind), SAMPLE, APART_US)
        for kind in ("normal", "uniform", "pareto")
    ),
    *(
        Feature(f"reordering jitter {kind}", LinkPlan(**WIDE, distribution=kind, reordering=True), SAMPLE, 5_000)
        for kind in ("normal", "uniform", "pareto")
    ),
)
CHANCE = (
    Feature("loss", LinkPlan(loss=0.1, delay_us=10_000), 2000, 5_000),
    Feature("duplicate", LinkPlan(duplicate=0.1, delay_us=20_000), 2000, 5_000),
    Feature("corrupt", LinkPlan(corrupt=0.1, delay_us=10_000), 2000, 5_000, LARGE),
    Feature("reorder", LinkPlan(reorder=0.2, delay_us=30_000), 2000, 5_000),
    Feature("loss and duplicate", LinkPlan(loss=0.2, duplicate=0.3, delay_us=10_000), 2000, 5_000),
    Feature(
        "all at once",
        LinkPlan(
            rate_bps=2_000_000, queue_packets=50, **WIDE, reordering=True,
            loss=0.1, duplicate=0.1, corrupt=0.1, reorder=0.1,
        ),
        2000, 7_000, LARGE,
    ),
)  # fmt: skip
RATE = (
    Feature("overload", QUEUE, 2000, 1_140, 285),
    Feature("burst", LinkPlan(rate_bps=200_000, queue_packets=20, delay_us=60_000), 60, 0, LARGE),
    Feature("rate and loss", LinkPlan(rate_bps=1_000_000, queue_packets=20, loss=0.2), 2000, 1_140, 285),
    Feature("rate and duplicate", LinkPlan(rate_bps=1_000_000, queue_packets=20, duplicate=0.3), 1500, 2_400, 285),
    Feature("slow", LinkPlan(rate_bps=64_000, queue_packets=30), 150, 200_000, LARGE),
    Feature("rate and jitter", LinkPlan(rate_bps=1_000_000, queue_packets=20, **JITTERED), 400, 50_700, LARGE),
)
SHARED = LinkPlan(rate_bps=64_000, queue_packets=30)


def _of_features(name: str, features: Sequence[Feature]) -> list[Round]:
    """Rounds in which each feature has a direction of a link for itself; as many as that takes."""
    ways = [(f"{link.name}:{way}", ends) for link in topology().links for way, ends in _ends(link.lower, link.upper)]
    found = []
    for first in range(0, len(features), len(ways)):
        chosen = list(zip(ways, features[first : first + len(ways)], strict=False))
        links = {way: feature.link for (way, _), feature in chosen}
        flows = [Flow(each.name, *ends, each.count, each.every_us, each.size) for (_, ends), each in chosen]
        found.append(Round(name, _plan(name, links), tuple(flows)))
    return found


def _ends(lower: str, upper: str) -> list[tuple[str, tuple[str, str]]]:
    return [("up", (lower, upper)), ("down", (upper, lower))]


def _plan(name: str, links: Mapping[str, LinkPlan], events: Sequence[EventPlan] = ()) -> LinksPlan:
    names = [f"{link.name}:{way}" for link in topology().links for way in ("up", "down")]
    return LinksPlan(name, SEED, {each: links.get(each, LinkPlan()) for each in names}, tuple(events))


def _shared() -> Round:
    """Half duplex links: both ways overfull with frames of one size and of two, and a quiet way against a full one."""
    links = {}
    for drone in (1, 2, 3):
        up, down = f"air:uav{drone}:up", f"air:uav{drone}:down"
        links |= {up: _with(SHARED, shared_with=down), down: _with(SHARED, shared_with=up)}
    flows = (
        Flow("shared, equal frames", "uav1", "fog1", 300, 66_000, 500),
        Flow("equal down", "fog1", "uav1", 300, 66_000, 500),
        Flow("shared, large and small", "uav2", "fog1", 150, 132_000, 1_000),
        Flow("small down", "fog1", "uav2", 1200, 16_500, 125),
        Flow("full up", "uav3", "fog1", 200, 100_000, 1_000),
        Flow("shared, quiet way", "fog1", "uav3", 50, 401_300, 100, 3_000_000),
    )
    return Round("shared", _plan("shared", links), flows)


def _with(link: LinkPlan, **changes: Any) -> LinkPlan:
    return LinkPlan(**{**asdict(link), **changes})


def _events() -> Round:
    """A link that is closed for a time, one that gets slower and back, one whose delay changes."""
    links = {
        "wan:gs:up": LinkPlan(delay_us=10_000),
        "wan:gs:down": LinkPlan(rate_bps=1_000_000, queue_packets=30),
        "backhaul:fog1:up": LinkPlan(delay_us=10_000, loss=0.1),
    }
    events = (
        EventPlan(2.0, "wan:gs:up", 1.5, {"closed": True}),
        EventPlan(2.0, "wan:gs:down", 2.0, {"rate_bps": 100_000}),
        EventPlan(2.0, "backhaul:fog1:up", 2.0, {"delay_us": 60_000, "loss": 0.0}),
    )
    flows = (
        Flow("closed", "gs", "cloud", 600, 10_000),
        Flow("slower", "cloud", "gs", 300, 20_000, LARGE // 2),
        Flow("later", "fog1", "cloud", 600, 10_000),
    )
    return Round("events", _plan("events", links, events), flows)


def _profile(name: str) -> Round:
    """A profile of tc_profiles, from the ground station to a drone and back, over three links each."""
    profile = read_profile(name)
    plan = resolve(profile, topology(), "agreement", 1)
    flows = (
        Flow(f"{name} down", "gs", "uav1", PROFILE_SAMPLE, PROFILE_APART_US, 200),
        Flow(f"{name} up", "uav1", "gs", PROFILE_SAMPLE, PROFILE_APART_US, 200, PROFILE_APART_US // 2),
    )
    return Round(name, plan, flows)


def job(shaper: str, chosen: Sequence[Round]) -> dict[str, Any]:
    """The job for the machine."""
    there = topology()
    return {
        "nodes": {node.name: [node.address.rpartition(".")[0] + ".2", node.address] for node in there.nodes},
        "links": [[link.upper, link.lower] for link in there.links],
        "shaper": shaper,
        "rounds": [
            {
                "name": each.name,
                "plan": each.plan.to_data(),
                "kernel": commands_of(each.plan, there).to_data(),
                "flows": [{**asdict(flow), "size": flow.size - ETHERNET_BYTES} for flow in each.flows],
            }
            for each in chosen
        ],
    }
