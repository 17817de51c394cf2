"""After a run: random loss of every link, from the shaper's counters.

Each frame that reaches a link's loss is lost independently with the planned probability, so the number of lost frames
is binomial, and with duplicates nearly so. It must lie in the central interval that has 99.9 % of such counts for **all
links of a run together**: each of m links may be outside with a probability of 0.001/m (Bonferroni). With an interval
of 99.9 % for each of 12 lossy links, one run in 84 would be void although its links are right, one pair of attempts in
42; so it is one in 1,000. That costs little: with 12 links an interval of 3.9 instead of 3.3 standard errors to each
side.

The interval is exact: the binomial distribution's quantiles, summed from its terms (Johnson, Kemp, Kotz: Univariate
Discrete Distributions, 3.2), not the normal approximation, which is wrong where few frames are lost.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from ...plan.profiles.resolve import LinksPlan
from .expected import vanishing

OUTSIDE = 0.001
"""The probability that any link of a run is outside although all are right."""


@dataclass(frozen=True)
class LinkLoss:
    """A link's random loss: `lost` of the `frames` that could be lost; `note` says why the link is not judged."""

    link: str
    configured: float
    lost: int | None = None
    frames: int | None = None
    lowest: int | None = None
    highest: int | None = None
    note: str | None = None

    @property
    def measured(self) -> float | None:
        """The share lost; None without frames."""
        return self.lost / self.frames if self.lost is not None and self.frames else None

    @property
    def off(self) -> str | None:
        """Why the link is not as planned, in one line; None if it is, or if it is not judged."""
        if self.lost is None or self.lowest is None or self.highest is None:
            return None
        if self.lowest <= self.lost <= self.highest:
            return None
        return (
            f"{self.link} loss: configured {_percent(self.configured)}, measured {_percent(self.measured or 0.0)} "
            f"({self.lost} of {self.frames} frames); expected {self.lowest} to {self.highest}"
        )

    def to_data(self) -> dict[str, Any]:
        """The entry in calibration.json."""
        return {"configured": self.configured, "measured": self.measured, **asdict(self)}


def check_losses(plan: LinksPlan, counters: Mapping[str, Any], changed: Collection[str] = ()) -> tuple[str, ...]:
    """One line for each link whose random loss is not as planned."""
    return tuple(loss.off for loss in measure_losses(plan, counters, changed) if loss.off is not None)


def measure_losses(plan: LinksPlan, counters: Mapping[str, Any], changed: Collection[str] = ()) -> tuple[LinkLoss, ...]:
    """The random loss of every link of the plan. `counters` is counters.json; `changed` are links changed by hand.

    Links whose loss an event or a person changes are not judged: it is not counted which frames met which loss. Frames
    that a closed link refused or a full queue dropped could not be lost at random, and do not count. Copies do, by
    netem's rules (`vanishing`).
    """
    found = counters["links"]
    eventful = {event.link for event in plan.events if {"loss", "duplicate"} & set(event.change)}
    lossy = sum(1 for link in plan.links.values() if link.loss)
    outside = OUTSIDE / max(1, lossy)
    losses = []
    for name, link in plan.links.items():
        if name in eventful:
            losses.append(LinkLoss(name, link.loss, note="its loss changes by events"))
        elif name in changed or name.rpartition(":")[0] in changed:
            losses.append(LinkLoss(name, link.loss, note="changed by hand"))
        elif name not in found:
            losses.append(LinkLoss(name, link.loss, note="not counted"))
        else:
            lost, frames = found[name]["random"], found[name]["random"] + found[name]["left"]
            lowest, highest = binomial_interval(frames, vanishing(link), outside)
            losses.append(LinkLoss(name, link.loss, lost, frames, lowest, highest))
    return tuple(losses)


def binomial_interval(trials: int, share: float, outside: float) -> tuple[int, int]:
    """The lowest and the highest count that are not in a tail of at most `outside / 2`, of Binomial(trials, share)."""
    if trials == 0 or share <= 0.0:
        return 0, 0
    if share >= 1.0:
        return trials, trials
    return _lowest(trials, share, outside / 2), trials - _lowest(trials, 1 - share, outside / 2)


def _lowest(trials: int, share: float, tail: float) -> int:
    """The lowest count k with P(X <= k) > tail. The terms below the first one taken are too small to matter."""
    mean, deviation = trials * share, math.sqrt(trials * share * (1 - share))
    begin = max(0, math.floor(mean - 12 * deviation - 12))
    below = 0.0
    for count in range(begin, trials + 1):
        below += math.exp(_log_term(trials, share, count))
        if below > tail:
            return count
    return trials


def _log_term(trials: int, share: float, count: int) -> float:
    ways = math.lgamma(trials + 1) - math.lgamma(count + 1) - math.lgamma(trials - count + 1)
    return ways + count * math.log(share) + (trials - count) * math.log1p(-share)


def _percent(share: float) -> str:
    return f"{share * 100:.3g} %"
