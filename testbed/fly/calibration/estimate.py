"""Computes a link's figures from the probes that arrived."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .expected import SHARE

FEWEST = 5
"""The least number of probes for a figure."""


@dataclass(frozen=True)
class ArrivedProbe:
    """A probe that arrived; times in ns since the beginning of the calibration."""

    number: int
    sent_ns: int
    received_ns: int


@dataclass(frozen=True)
class DelayFigures:
    """One-way delays in ms, without the time of sending the probe. `middle` is the mean of the middle 80 %."""

    median_ms: float
    mean_ms: float
    deviation_ms: float
    middle_ms: float
    span_ms: float
    """From 10 % to 90 %."""


def first_copies(rows: Iterable[ArrivedProbe]) -> list[ArrivedProbe]:
    """The first copy of each probe, sorted by number."""
    found: dict[int, ArrivedProbe] = {}
    for row in rows:
        known = found.get(row.number)
        if known is None or row.received_ns < known.received_ns:
            found[row.number] = row
    return [found[number] for number in sorted(found)]


def delay_figures(rows: Sequence[ArrivedProbe], sending_ms: float) -> DelayFigures | None:
    """The delay figures of probes; None if too few arrived."""
    if len(rows) < FEWEST:
        return None
    delays = np.sort(np.array([(row.received_ns - row.sent_ns) / 1e6 for row in rows]) - sending_ms)
    cut = int(len(delays) * SHARE)
    middle = delays[cut : len(delays) - cut]
    low, high = np.quantile(delays, [SHARE, 1 - SHARE])
    return DelayFigures(
        median_ms=float(np.median(delays)),
        mean_ms=float(delays.mean()),
        deviation_ms=float(delays.std(ddof=1)),
        middle_ms=float(middle.mean()),
        span_ms=float(high - low),
    )


def rate_when_overfilled(rows: Sequence[ArrivedProbe], burst: int, frame_bytes: int, arriving: float) -> float | None:
    """The rate in bit/s at which a link with a full queue accepted frames, by the send times of those that arrived.

    It is taken from the last frame of the `burst` that filled the queue to the last frame of all. At both the queue is
    full, whatever pauses the sender made in between, unless it ran empty. A regression would count the frames with
    which a sender catches up as rate. `arriving` is the share of frames that are neither lost nor corrupted.
    """
    first = max((row for row in rows if row.number < burst), key=_number, default=None)
    paced = [row for row in rows if row.number >= burst]
    if first is None or len(paced) < FEWEST:
        return None
    lasts_s = (max(paced, key=_number).sent_ns - first.sent_ns) / 1e9
    return len(paced) * frame_bytes * 8 / lasts_s / arriving


def rate_when_received(rows: Sequence[ArrivedProbe], frame_bytes: int) -> float | None:
    """The rate in bit/s, by the arrival times of frames that were queued one after the other.

    A missing number was lost after it had been sent, so it has used the rate.
    """
    if len(rows) < FEWEST or np.ptp([row.received_ns for row in rows]) <= 0:
        return None
    times_s = np.array([row.received_ns / 1e9 for row in rows])
    numbers = np.array([row.number for row in rows], dtype=float)
    each_s = float(np.polyfit(numbers - numbers[0], times_s - times_s[0], 1)[0])
    return frame_bytes * 8 / each_s if each_s > 0 else None


def _number(row: ArrivedProbe) -> int:
    return row.number
