"""From probes that arrived to a link's figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .expected import SHARE

FEWEST = 5
"""Fewer than that say nothing."""


@dataclass(frozen=True)
class Row:
    """A probe that arrived; times in ns since the beginning of the calibration."""

    number: int
    sent_ns: int
    received_ns: int


@dataclass(frozen=True)
class DelayFigures:
    """One way, in ms, without the time that sending the probe takes. `middle` is the mean of the middle 80 %."""

    median_ms: float
    mean_ms: float
    deviation_ms: float
    middle_ms: float
    span_ms: float
    """From 10 % to 90 %."""


def first_copies(rows: Iterable[Row]) -> list[Row]:
    """Each probe once, as it came first, in the order of their numbers."""
    found: dict[int, Row] = {}
    for row in rows:
        known = found.get(row.number)
        if known is None or row.received_ns < known.received_ns:
            found[row.number] = row
    return [found[number] for number in sorted(found)]


def delay_figures(rows: Sequence[Row], sending_ms: float) -> DelayFigures | None:
    """None where too few arrived."""
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


def rate_when_overfilled(rows: Sequence[Row], burst: int, frame_bytes: int, arriving: float) -> float | None:
    """Bits a second at which a link with a full queue let frames in, off the times when those that arrived were sent.

    From the last frame of the `burst` that filled the queue to the last of all: at both ends it is full, whatever
    pauses the sender made between, as long as it did not run empty. A regression would take what a sender catches up
    with for rate. `arriving` is the share that neither loss nor corruption takes.
    """
    first = max((row for row in rows if row.number < burst), key=_number, default=None)
    paced = [row for row in rows if row.number >= burst]
    if first is None or len(paced) < FEWEST:
        return None
    lasts_s = (max(paced, key=_number).sent_ns - first.sent_ns) / 1e9
    return len(paced) * frame_bytes * 8 / lasts_s / arriving


def rate_when_received(rows: Sequence[Row], frame_bytes: int) -> float | None:
    """Bits a second, off the times of arrival of frames that wait for the rate one behind the other.

    A number that is missing was lost after it had been sent: it has used the rate.
    """
    if len(rows) < FEWEST or np.ptp([row.received_ns for row in rows]) <= 0:
        return None
    times_s = np.array([row.received_ns / 1e9 for row in rows])
    numbers = np.array([row.number for row in rows], dtype=float)
    each_s = float(np.polyfit(numbers - numbers[0], times_s - times_s[0], 1)[0])
    return frame_bytes * 8 / each_s if each_s > 0 else None


def _number(row: Row) -> int:
    return row.number
