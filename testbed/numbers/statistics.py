"""Statistics over attempts: the interval of a mean, and a paired test of both sides."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from .attempt_entry import LossEntry
from .written import PairedTestEntry

ENOUGH = 6
"""The least number of attempts for an interval and a test; with fewer there are only points."""
RESAMPLES = 10_000
SEED = 20_250_115
ALL_SIGNS = 14
"""Up to this many pairs every assignment of signs is tried; above it, RESAMPLES random ones."""
_TINY = 1e-9

Values = np.ndarray[Any, np.dtype[np.float64]]


def interval(points: Sequence[float]) -> tuple[float, float] | None:
    """The 95 % bootstrap interval of the mean (percentiles of resampled means); None below six points."""
    if len(points) < ENOUGH:
        return None
    least, most = (significant(edge) for edge in resampled(np.array(points, dtype=np.float64), SEED))
    return least, most


def resampled(values: Values, seed: int) -> tuple[float, float]:
    """The edges of the middle 95 % of resampled means."""
    drawn = np.random.default_rng(seed).integers(0, len(values), size=(RESAMPLES, len(values)))
    low, high = np.percentile(values[drawn].mean(axis=1), (2.5, 97.5))
    return float(low), float(high)


def paired_test(differences: Sequence[float]) -> PairedTestEntry | None:
    """A two-sided permutation test that flips the signs of paired differences; None below six pairs.

    `effect` is the matched-pairs rank-biserial correlation: 1 when every pair differs upwards, -1 when downwards, 0
    when both ways balance (Kerby 2014).
    """
    if len(differences) < ENOUGH:
        return None
    values = np.array(differences, dtype=np.float64)
    if len(values) <= ALL_SIGNS:
        signs = np.array(list(itertools.product((1.0, -1.0), repeat=len(values))))
        extra = 0
    else:
        signs = np.random.default_rng(SEED).choice((1.0, -1.0), size=(RESAMPLES, len(values)))
        extra = 1  # the observed signs are one of the possible assignments
    sums, seen = np.abs(signs @ values), abs(float(values.sum()))
    as_far = int((sums >= seen - _TINY * max(1.0, float(np.abs(values).sum()))).sum())
    return {
        "pairs": len(values),
        "difference": significant(float(values.mean())),
        "p": significant((as_far + extra) / (len(sums) + extra)),
        "effect": significant(_rank_biserial(values)),
    }


def significant(value: float) -> float:
    """A number rounded to nine significant digits, so that it is the same on every machine."""
    return float(f"{value:.9g}")


def _rank_biserial(values: Values) -> float:
    told = values[values != 0]
    if not len(told):
        return 0.0
    sizes = np.abs(told)
    ranks = np.array([(sizes < size).sum() + ((sizes == size).sum() + 1) / 2 for size in sizes])
    return float((ranks * np.sign(told)).sum() / ranks.sum())


def loss_of(sent: int, lost: int, still_open: int = 0) -> LossEntry:
    """A loss: `share` is lost / n, where n is `sent` less `still_open`. If none was lost, `below` is 3/n, the 95 %
    bound by the rule of three."""
    known = sent - still_open
    return {
        "sent": sent,
        "lost": lost,
        "share": significant(lost / known) if known else None,
        "below": significant(min(1.0, 3 / known)) if known and not lost else None,
    }
