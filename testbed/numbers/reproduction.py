"""Whether a finding is reproduced: bootstrap intervals over paired attempts, against margins fixed beforehand."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..plan.headline import LEAST_ATTEMPTS, RATIO, HeadlineCell, HeadlineLine
from .observed import NO_SIDE, Sides
from .quantities import DOUBLED, LATE, LONGEST_STATE, QUANTITIES, SUCCESS
from .quantity import ABOVE, BELOW, Quantity
from .statistics import resampled, significant

REPRODUCED, NOT_REPRODUCED, UNDECIDED = "reproduced", "not reproduced", "undecided"
JUDGED: dict[str, Quantity] = {one.key: one for one in (*QUANTITIES, LONGEST_STATE, DOUBLED, LATE, SUCCESS)}
"""The quantities that a line of the table may name; the table's schema has those with a value for each attempt."""


@dataclass(frozen=True)
class Estimate:
    """A mean over attempts and its 95 % bootstrap interval (percentiles)."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class JudgedLine:
    """A line of the table as measured: `points` by attempt, and the attempts without a value in `missing`."""

    line: HeadlineLine
    quantity: Quantity
    points: Mapping[int, float]
    missing: tuple[int, ...]
    estimate: Estimate | None

    @property
    def verdict(self) -> str:
        """The verdict: interval inside the margin, outside, or across an edge (undecided, as without an interval)."""
        if self.estimate is None:
            return UNDECIDED
        low, high = self.line.margin
        if low <= self.estimate.low and self.estimate.high <= high:
            return REPRODUCED
        return NOT_REPRODUCED if self.estimate.high < low or self.estimate.low > high else UNDECIDED


def judge(cell: HeadlineCell, sides: Sides, seed: int) -> list[JudgedLine]:
    """Judge every line of a cell by the attempts of a series that count."""
    return [_judged(line, sides, cell.plan.attempts, seed) for line in cell.lines]


def verdict_of(judged: Sequence[JudgedLine]) -> str:
    """The verdict over all lines: reproduced if every one is, not reproduced if at least one is not."""
    verdicts = {one.verdict for one in judged}
    if NOT_REPRODUCED in verdicts:
        return NOT_REPRODUCED
    return REPRODUCED if verdicts == {REPRODUCED} else UNDECIDED


def estimate(points: Sequence[float], seed: int, *, ratios: bool = False) -> Estimate | None:
    """The mean of the points, geometric for `ratios` (above 0), and the interval of resampled means.

    Paired attempts are resampled as pairs: a point is the ratio of both. None below three points.
    """
    if len(points) < LEAST_ATTEMPTS:
        return None
    values = np.array(points, dtype=np.float64)
    values = np.log(values) if ratios else values
    back: Callable[[float], float] = math.exp if ratios else float
    found = (significant(back(value)) for value in (float(values.mean()), *resampled(values, seed)))
    return Estimate(*found)


def paired_ratios(above: Mapping[int, float], below: Mapping[int, float]) -> dict[int, float]:
    """By attempt the value in `above` over that in `below`; attempts where one is missing or zero are left out."""
    both = sorted(set(above) & set(below))
    return {number: above[number] / below[number] for number in both if above[number] > 0 and below[number] > 0}


def _judged(line: HeadlineLine, sides: Sides, attempts: int, seed: int) -> JudgedLine:
    quantity = JUDGED[line.quantity]
    by_side = {name: quantity.points(sides.get(name, NO_SIDE)) for name in (ABOVE, BELOW)}
    is_ratio = line.of == RATIO
    found = paired_ratios(by_side[ABOVE], by_side[BELOW]) if is_ratio else by_side[line.of]
    points = {number: found[number] for number in sorted(found) if number <= attempts}
    missing = tuple(number for number in range(1, attempts + 1) if number not in points)
    return JudgedLine(line, quantity, points, missing, estimate(tuple(points.values()), seed, ratios=is_ratio))
