"""The figures that probes of a link should give, and how far a right link may be off them.

Delays are compared by the mean of their middle 80 %, and jitter by the span of it: a busy machine delays single probes
by tens of milliseconds, which would shift a mean and inflate a deviation.

Jitter that keeps order is a slow process: the emulator's value at an instant follows from two independent ones at the
ends of a slot of 5 jitters (10 for Pareto). Each of those weighs 4/pi slots in a mean over time, so a mean over many
slots varies as that of (pi/4)^2 = 0.62 independent values per slot. netem draws a value for every frame; for it the
tolerances are wider than necessary.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from net.link_plan import SLOT_JITTERS, LinkPlan

WIDTH = 3.29
"""Standard errors to each side: 99.9 % of right figures are within, so one in a thousand is probed again needlessly."""
SHARE = 0.1
"""The share of delays that is left out at each end."""
EARLY_MS, LATE_MS, RELATIVE = 0.3, 2.0, 0.01
"""Tolerances beyond chance: early (no frame should leave early), late (a busy machine delays frames), and as a share
(clocks and rounding)."""
VALUES_A_SLOT = (math.pi / 4) ** 2
_POINTS = 4_000
_WIDEST = 4.0
_STEP = 0.05


@dataclass(frozen=True)
class Interval:
    """The expected value, and the bounds within which a measurement is accepted."""

    expected: float
    lowest: float
    highest: float

    def holds(self, value: float | None) -> bool:
        return value is not None and self.lowest <= value <= self.highest


@dataclass(frozen=True)
class ExpectedDelays:
    """The distribution of a link's delays in ms, without the time of sending a frame at the link's rate."""

    link: LinkPlan

    @cached_property
    def _values(self) -> NDArray[np.float64]:
        shares = (np.arange(_POINTS) + 0.5) / _POINTS
        jitters = np.array([_quantile(self.link.distribution, share) for share in shares])
        values = np.maximum(0.0, self.link.delay_us + jitters * self.link.jitter_us) / 1e3
        values[: round(self.link.reorder * _POINTS)] = 0.0
        return np.sort(values)

    def independent(self, probes: float, seconds: float) -> float:
        """How many independent values a number of probes over a number of seconds stand for; at least 2."""
        if self.link.reordering or not self.link.jitter_us:
            return max(2.0, probes)
        slots = seconds / (SLOT_JITTERS[self.link.distribution] * self.link.jitter_us / 1e6)
        return max(2.0, min(probes, VALUES_A_SLOT * slots))

    def middle_ms(self, probes: float, seconds: float) -> Interval:
        """The interval for the mean of the middle 80 %."""
        low, high = (int(_POINTS * share) for share in (SHARE, 1 - SHARE))
        expected = float(self._values[low:high].mean())
        chance = WIDTH * float(self._values.std()) * 1.03 / math.sqrt(self.independent(probes, seconds))
        spare = RELATIVE * expected
        return Interval(expected, expected - EARLY_MS - spare - chance, expected + LATE_MS + spare + chance)

    @property
    def span_ms(self) -> float:
        """The span from the 10 % to the 90 % quantile."""
        return self._at(1 - SHARE) - self._at(SHARE)

    def jitter_ms(self, probes: float, seconds: float) -> Interval:
        """The interval for the jitter, which is derived from the span."""
        jitter_ms = self.link.jitter_us / 1e3
        if not self.span_ms:
            return Interval(jitter_ms, 0.0, LATE_MS)
        low, high = self._slope(SHARE), self._slope(1 - SHARE)
        variance = SHARE * (1 - SHARE) * (low**2 + high**2) - 2 * SHARE**2 * low * high
        error = math.sqrt(variance / self.independent(probes, seconds)) / self.span_ms
        factor = math.exp(WIDTH * error)
        return Interval(jitter_ms, jitter_ms / factor - EARLY_MS, jitter_ms * factor + LATE_MS)

    def jitter_of(self, span_ms: float) -> float:
        """The jitter for a measured span; for a link without jitter the deviation of a normal distribution."""
        if self.span_ms:
            return span_ms * self.link.jitter_us / 1e3 / self.span_ms
        return span_ms / (2 * NormalDist().inv_cdf(1 - SHARE))

    def _at(self, share: float) -> float:
        return float(np.quantile(self._values, share))

    def _slope(self, share: float) -> float:
        """By how much a quantile changes with its share."""
        return (self._at(share + _STEP) - self._at(share - _STEP)) / (2 * _STEP)


def rate_bps(link: LinkPlan, frames: int, seconds: float, chance: float = 0.0) -> Interval:
    """The interval for a rate that is measured with about `frames` frames in `seconds`.

    It allows for 2 %, two frames, a busy machine's 2 ms at the ends, the lost frames, and `chance`, the relative
    standard error caused by jitter.
    """
    rate = float(link.rate_bps or 0)
    share = arriving(link)
    thinned = math.sqrt(1.2 * (1 - share) / (share * frames))
    spare = 2 * RELATIVE + 2 / frames + LATE_MS / 1e3 / seconds + WIDTH * math.hypot(thinned, chance)
    return Interval(rate, rate * (1 - spare), rate * (1 + spare))


def arriving(link: LinkPlan) -> float:
    """The share of probes that arrive, they or their copies: one with a flipped bit fails the checksum of UDP or IP."""
    passed = 1 - link.loss * (1 - link.duplicate)  # chosen to be both lost and duplicated, it passes once
    rescued = link.corrupt * link.duplicate * (1 - link.loss) ** 2
    return (1 - link.corrupt) * (passed + rescued)


def vanishing(link: LinkPlan) -> float:
    """The share of frames and copies together that random loss takes, by netem's rules."""
    copies = (1 - link.loss) * link.duplicate
    return link.loss * (1 - link.duplicate + copies) / (1 + copies)


def _quantile(distribution: str, share: float) -> float:
    """A quantile in jitters, as in netem's tables (iproute2, netem/normal.c and pareto.c, shape 3), cut off at 4."""
    if distribution == "uniform":
        return 2 * share - 1
    if distribution == "pareto":
        return min(_WIDEST, (math.pow(1 - share, -1 / 3) - 1.5) * 4 / 3)
    return max(-_WIDEST, min(_WIDEST, NormalDist().inv_cdf(share)))
