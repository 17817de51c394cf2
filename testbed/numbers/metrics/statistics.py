"""Statistics over attempts: every attempt a point, means, medians, intervals, and a paired test of both sides."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from statistics import mean, median
from typing import Any

import numpy as np

ENOUGH = 6
"""Attempts from which on there is an interval and a test; below there are points only."""
RESAMPLES = 10_000
SEED = 20_250_115
ALL_SIGNS = 14
"""Up to so many pairs every assignment of signs is tried, above a random choice of RESAMPLES."""
_TINY = 1e-9

Attempt = Mapping[str, Any]


def _per_second(field: str) -> Callable[[Attempt], float | None]:
    return lambda attempt: attempt[field] / attempt["mission_s"] if attempt["mission_s"] else None


def _total(field: str) -> Callable[[Attempt], float | None]:
    return lambda attempt: sum(attempt[field].values()) if attempt[field] else None


def _middle_delay(attempt: Attempt) -> float | None:
    values = [value for values in attempt["delay_ms"].values() for value in values]
    return mean(values) if values else None


QUANTITIES: dict[str, Callable[[Attempt], float | None]] = {
    "mission_s": lambda attempt: attempt["mission_s"],
    "packets": lambda attempt: attempt["packets"],
    "size_bytes": lambda attempt: attempt["size_bytes"],
    "packets_per_s": _per_second("packets"),
    "bytes_per_s": _per_second("size_bytes"),
    "commands_lost": lambda attempt: attempt["message_loss"]["commands"],
    "states_lost": lambda attempt: attempt["message_loss"]["states"],
    "wire_loss": lambda attempt: attempt["wire_loss"],
    "delay_ms": _middle_delay,
    "retransmissions": lambda attempt: attempt["retransmissions"]["packets"],
    "cpu_s": _total("cpu_s"),
    "memory_bytes": _total("memory_bytes"),
}
"""What an attempt's entry in metrics.json is boiled down to; losses are shares, delay is the mean over commands."""


def statistics(protocols: Mapping[str, Any]) -> dict[str, Any]:
    """Completion of each protocol, then each quantity over its completed attempts, and what pooled losses prove."""
    return {
        "completion": {name: _completion(side) for name, side in protocols.items()},
        "metrics": {name: _quantity(protocols, value) for name, value in QUANTITIES.items()},
        "losses": {
            what: {name: _pooled(side, *fields) for name, side in protocols.items()} for what, fields in _LOSSES.items()
        },
    }


def interval(points: list[float]) -> list[float] | None:
    """The 95 % bootstrap interval of the mean (percentiles of resampled means); None below six points."""
    if len(points) < ENOUGH:
        return None
    drawn = np.random.default_rng(SEED).integers(0, len(points), size=(RESAMPLES, len(points)))
    means = np.array(points, dtype=np.float64)[drawn].mean(axis=1)
    return [significant(float(edge)) for edge in np.percentile(means, (2.5, 97.5))]


def paired_test(differences: list[float]) -> dict[str, Any] | None:
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


def significant(value: float, digits: int = 9) -> float:
    """A number rounded to significant digits, so that it is the same on every machine."""
    return float(f"{value:.{digits}g}")


def _rank_biserial(values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    told = values[values != 0]
    if not len(told):
        return 0.0
    sizes = np.abs(told)
    ranks = np.array([(sizes < size).sum() + ((sizes == size).sum() + 1) / 2 for size in sizes])
    return float((ranks * np.sign(told)).sum() / ranks.sum())


def _completion(side: Mapping[str, Any]) -> dict[str, int]:
    done = sum(attempt["status"] == "completed" for attempt in side["attempts"])
    flown = len(side["attempts"])
    return {"flown": flown, "completed": done, "failed": flown - done, "void": len(side["void"])}


def _quantity(protocols: Mapping[str, Any], value: Callable[[Attempt], float | None]) -> dict[str, Any]:
    points = {name: _points(side, value) for name, side in protocols.items()}
    found: dict[str, Any] = {}
    for name, by_attempt in points.items():
        values = list(by_attempt.values())
        found[name] = {
            "n": len(values),
            "mean": significant(mean(values)) if values else None,
            "median": significant(median(values)) if values else None,
            "interval": interval(values),
            "points": {str(number): significant(value) for number, value in by_attempt.items()},
        }
    both = [points.get(name, {}) for name in ("mavlink", "mqttxt")]
    pairs = sorted(set(both[0]) & set(both[1]))
    return {**found, "test": paired_test([both[0][number] - both[1][number] for number in pairs])}


def _points(side: Mapping[str, Any], value: Callable[[Attempt], float | None]) -> dict[int, float]:
    """By attempt; a failed one is censored: it is counted in `completion` and has no value here."""
    done = (attempt for attempt in side["attempts"] if attempt["status"] == "completed")
    found = ((attempt["attempt"], value(attempt)) for attempt in done)
    return {number: float(point) for number, point in found if point is not None}


_LOSSES: dict[str, tuple[str, ...]] = {
    "commands": ("messages", "commands"),
    "states": ("messages", "states"),
    "frames": ("frames",),
}


def _pooled(side: Mapping[str, Any], *fields: str) -> dict[str, Any]:
    """All completed attempts together: so many lost of so many; where none was, less than 3/n at 95 %."""
    sent = lost = still_open = 0
    for attempt in side["attempts"]:
        if attempt["status"] != "completed":
            continue
        if fields[0] == "frames":
            sent, lost = sent + attempt["packets"], lost + sum(link["lost"] for link in attempt["links"].values())
        else:
            kinds = attempt["messages"][fields[1]].values()
            sent, lost = sent + sum(kind["sent"] for kind in kinds), lost + sum(kind["lost"] for kind in kinds)
            still_open += sum(kind["open"] for kind in kinds)
    return loss_of(sent, lost, still_open)


def loss_of(sent: int, lost: int, still_open: int = 0) -> dict[str, Any]:
    """`share` is lost / n, n what was sent but for what is still open; where nothing of it was lost, `below` is 3/n:
    the rule of three's bound at 95 %."""
    known = sent - still_open
    return {
        "sent": sent,
        "lost": lost,
        "share": significant(lost / known) if known else None,
        "below": significant(min(1.0, 3 / known)) if known and not lost else None,
    }
