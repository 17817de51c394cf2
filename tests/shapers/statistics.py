"""Distances between two samples, and how far apart two of one source may be by chance."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from statistics import NormalDist, fmean

CHANCE = 1e-6
"""How often a comparison of two samples of the same source may fail; there are some hundred comparisons."""
DEVIATIONS = -NormalDist().inv_cdf(CHANCE / 2)


def ks_distance(one: Sequence[float], other: Sequence[float], slack: float = 0.0) -> float:
    """Kolmogorov and Smirnov's: the greatest difference between the two shares of values up to a value.

    With `slack` a value of one may be counted that much later in the other, whatever is nearer: where many values are
    the same, a difference of a hundredth would otherwise set all of them apart.
    """
    ones, others = sorted(one), sorted(other)
    return max(0.0, _ahead(ones, others, slack), _ahead(others, ones, slack))


def _ahead(ones: Sequence[float], others: Sequence[float], slack: float) -> float:
    return max(
        bisect_right(ones, value) / len(ones) - bisect_right(others, value + slack) / len(others) for value in ones
    )


def ks_limit(size: int, other: int) -> float:
    """What the distance of two samples of one distribution exceeds by CHANCE (Smirnov's limit, for large samples)."""
    return math.sqrt(-math.log(CHANCE / 2) / 2 * (size + other) / (size * other))


def share_limit(share: float, size: int, other: int) -> float:
    """What two shares of independent frames with one probability differ by with CHANCE; half a frame more at least."""
    return DEVIATIONS * math.sqrt(share * (1 - share) * (1 / size + 1 / other)) + 0.5 / min(size, other)


def mean_limit(deviation: float, size: int, other: int) -> float:
    """What the means of two samples differ by with CHANCE."""
    return DEVIATIONS * deviation * math.sqrt(1 / size + 1 / other)


def beyond(values: Sequence[float], distance: float) -> float:
    """The share that is further than that from the mean: what tells distributions of the same deviation apart."""
    mean = fmean(values)
    return sum(abs(value - mean) > distance for value in values) / len(values)


def overtaken(numbers: Sequence[int]) -> int:
    """How many came after one that was sent later."""
    latest, found = -1, 0
    for number in numbers:
        found += number < latest
        latest = max(latest, number)
    return found
