"""The plan of a run's links, which the testbed draws from a profile, and by which `net` shapes them.

Both sides import these classes and constants from here. The module has only data, and imports nothing of `net`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

VERSION = 1
"""The version of a plan."""
RUN_VERSION = 1
"""The version of `plan.json`, which has a plan with the shaper, the kernel's commands and the gates."""
DIRECTIONS = ("up", "down")
DISTRIBUTIONS = ("normal", "uniform", "pareto")
SLOT_JITTERS = {"normal": 5, "uniform": 5, "pareto": 10}
"""The length of a slot of the emulator's jitter, in jitters. With it the delay falls slower than time passes, also in a
steep tail.
"""
SHAPERS = ("auto", "netem", "nfqueue")


@dataclass(frozen=True)
class LinkPlan:
    """The figures by which one directed link is shaped: `rate_bps` with its queue first, then delay and all others.

    rate_bps       bits of Ethernet frames without FCS per second; None: unlimited
    queue_packets  frames that the rate stage holds, including the one being sent; one more is dropped
    shared_with    the other direction, if both take turns at one rate
    delay_us       the mean delay
    jitter_us      the scale of the distribution: its deviation (normal, pareto), or the width to either side (uniform)
    reordering     whether jitter may let a frame overtake another
    loss, duplicate, corrupt, reorder  shares of frames
    """

    rate_bps: int | None = None
    queue_packets: int | None = None
    shared_with: str | None = None
    delay_us: int = 0
    jitter_us: int = 0
    distribution: str = DISTRIBUTIONS[0]
    reordering: bool = False
    loss: float = 0.0
    duplicate: float = 0.0
    corrupt: float = 0.0
    reorder: float = 0.0

    @property
    def is_shaped(self) -> bool:
        """Whether anything is done to its frames."""
        return self != type(self)(distribution=self.distribution, reordering=self.reordering)


@dataclass(frozen=True)
class EventPlan:
    """From `at_s` on, for `for_s` seconds, `change` overrides a link's figures; `closed` lets nothing through.

    Times are since the links' clock began.
    """

    at_s: float
    link: str
    for_s: float
    change: Mapping[str, Any]


@dataclass(frozen=True)
class BaseLinksPlan:
    """All links of a run by name, as `air:uav1:up`, and the events in the order of their times."""

    profile: str
    seed: int
    links: Mapping[str, LinkPlan]
    events: tuple[EventPlan, ...] = ()

    def to_data(self) -> dict[str, Any]:
        """The plan for JSON."""
        return {
            "version": VERSION,
            "profile": self.profile,
            "seed": self.seed,
            "links": {name: asdict(link) for name, link in self.links.items()},
            "events": [asdict(event) for event in self.events],
        }


@dataclass(frozen=True)
class Gate:
    """A link that is open, in both directions, while a drone is within `range_m` of a place on the ground."""

    link: str
    drone: int
    latitude_deg: float
    longitude_deg: float
    range_m: float = 50.0

    @property
    def ways(self) -> tuple[str, ...]:
        """The directed links."""
        return tuple(f"{self.link}:{direction}" for direction in DIRECTIONS)
