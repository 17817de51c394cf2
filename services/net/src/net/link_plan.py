"""The plan of a run's links: what the testbed draws from a profile, and what `net` shapes by.

Both sides take these classes and constants from here. It is data alone, and imports nothing of `net`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

VERSION = 1
"""Of a plan."""
RUN_VERSION = 1
"""Of `plan.json`, which has a plan beside the shaper, the kernel's commands and the gates."""
DIRECTIONS = ("up", "down")
DISTRIBUTIONS = ("normal", "uniform", "pareto")
SLOT_JITTERS = {"normal": 5, "uniform": 5, "pareto": 10}
"""How long a slot of the emulator's jitter is, in jitters: the delay falls slower than time passes, also in a steep
tail.
"""
SHAPERS = ("auto", "netem", "nfqueue")


@dataclass(frozen=True)
class LinkPlan:
    """What a shaper does to one directed link: `rate_bps` with its queue first, then delay and all the rest.

    rate_bps       bits of Ethernet frames without FCS per second; None: unlimited
    queue_packets  frames that the rate stage holds, the one that is being sent included; one more is dropped
    shared_with    the other direction, where both take turns at the one rate
    delay_us       the mean
    jitter_us      what the distribution is scaled by: its deviation (normal, pareto), or either side (uniform)
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
        """Whether anything at all is done to its frames."""
        return self != type(self)(distribution=self.distribution, reordering=self.reordering)


@dataclass(frozen=True)
class EventPlan:
    """From `at_s` on, for `for_s` seconds, `change` stands above a link's figures; `closed` lets nothing through.

    Times are since the links' clock began.
    """

    at_s: float
    link: str
    for_s: float
    change: Mapping[str, Any]


@dataclass(frozen=True)
class Plan:
    """All links of a run by name, as `air:uav1:up`, and the events in the order of their times."""

    profile: str
    seed: int
    links: Mapping[str, LinkPlan]
    events: tuple[EventPlan, ...] = ()

    def to_data(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "version": VERSION,
            "profile": self.profile,
            "seed": self.seed,
            "links": {name: asdict(link) for name, link in self.links.items()},
            "events": [asdict(event) for event in self.events],
        }


@dataclass(frozen=True)
class Gate:
    """A link, both ways, that is open while a drone is within `range_m` of a place on the ground."""

    link: str
    drone: int
    latitude_deg: float
    longitude_deg: float
    range_m: float = 50.0

    @property
    def ways(self) -> tuple[str, ...]:
        """The directed links."""
        return tuple(f"{self.link}:{direction}" for direction in DIRECTIONS)
