"""Distances between two samples, and how far apart two samples of one source may be by chance."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from statistics import NormalDist, fmean

CHANCE = 1e-6
"""How often a comparison of two samples of the same source may fail; there are some hundred comparisons."""
DEVIATIONS = -NormalDist().inv_cdf(CHANCE / 2)


def ks_distance(one: Sequence[float], other: Sequence[float], slack: float = 0.0) -> float:
    """The Kolmogorov-Smirnov distance: the greatest difference between the two shares of values up to a value.

    With `slack` a value of one sample counts up to that much later in the other: where many values are the same, a
    difference of a hundredth would otherwise set all of them apart.
    """
    ones, others = sorted(one), sorted(other)
    return max(0.0, _ahead(ones, others, slack), _ahead(others, ones, slack))


def _ahead(ones: Sequence[float], others: Sequence[float], slack: float) -> float:
    return max(
        bisect_right(ones, value) / len(ones) - bisect_right(others, value + slack) / len(others) for value in ones
    )


def ks_limit(size: int, other: int) -> float:
    """The distance that two samples of one distribution exceed with CHANCE (Smirnov's limit, for large samples)."""
    return math.sqrt(-math.log(CHANCE / 2) / 2 * (size + other) / (size * other))


def share_limit(share: float, size: int, other: int) -> float:
    """The difference that two shares of independent frames of one probability exceed with CHANCE, plus half a frame."""
    return DEVIATIONS * math.sqrt(share * (1 - share) * (1 / size + 1 / other)) + 0.5 / min(size, other)


def mean_limit(deviation: float, size: int, other: int) -> float:
    """The difference that the means of two samples exceed with CHANCE."""
    return DEVIATIONS * deviation * math.sqrt(1 / size + 1 / other)


def beyond(values: Sequence[float], distance: float) -> float:
    """The share of values further than `distance` from the mean: it distinguishes distributions of equal deviation."""
    mean = fmean(values)
    return sum(abs(value - mean) > distance for value in values) / len(values)


def overtaken(numbers: Sequence[int]) -> int:
    """How many arrived after one that was sent later."""
    latest, found = -1, 0
    for number in numbers:
        found += number < latest
        latest = max(latest, number)
    return found
