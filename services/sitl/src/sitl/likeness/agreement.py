"""Where two recordings of the same cases differ by more than is allowed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from .recording import Case, Recording

Range = tuple[float, float]
"""The least and the greatest value of several flights."""

DURATION = 0.10
"""The allowed difference of durations, as a part of the larger bound of the first."""
TOLD_BY_HEARTBEAT = frozenset({"armed", "disarmed", "takeoff to hold", "offboard", "hold"})
HEARTBEAT_S, SHORT_S = 1.1, 0.35
"""The difference of durations that is always allowed: a heartbeat's interval if one reports the end, else samples."""
TOTAL, KIND = 0.05, 0.10
"""The allowed differences of messages and bytes per second: of all kinds together, and of each kind."""
FEW_HZ = 0.11
"""Two messages in the counted time."""
NOISE = 2.0
"""Standard deviations agree within this factor."""
SPEED, SPEED_M_S = 0.10, 0.3
HEIGHT_M = 1.0
CHANGES, FEW_CHANGES = 0.5, 3
"""The allowed difference of how often a rarely sent value changes: as a part, and as a number."""
FEW_TOLD = 2
"""The allowed difference among ten refusals, whose text may arrive a datagram earlier or later."""
BATTERY_PCT = 4
CURRENT = 0.10
DELAY_S = 0.3


@dataclass(frozen=True)
class Fact:
    """One fact of a case in both recordings, and whether the two agree."""

    case: str
    name: str
    first: str
    second: str
    agrees: bool

    def __str__(self) -> str:
        return f"{self.case}: {self.name}: {self.first} and {self.second}"


def compare(first: Recording, second: Recording) -> list[Fact]:
    """Every fact of the cases that both have, in the order of the first."""
    both = [name for name in first.cases if name in second.cases]
    return [fact for name in both for fact in _facts(name, first.cases[name], second.cases[name])]


def _facts(name: str, a: list[Case], b: list[Case]) -> Iterator[Fact]:
    for number in range(max(len(case.acks) for case in (*a, *b))):
        command = next(case.acks[number][0] for case in (*a, *b) if number < len(case.acks))
        first, second = ([_result(case, number) for case in cases] for cases in (a, b))
        yield _words(name, f"acknowledgement {number + 1}, {command}", first, second)
    for what in ("armed", "mode", "landed_state"):
        yield _words(name, what, *([_course(case, what) for case in cases] for cases in (a, b)))
    for key in _keys(*(case.durations_s for case in (*a, *b))):
        least = HEARTBEAT_S if key in TOLD_BY_HEARTBEAT else SHORT_S
        ranges = (_range(case.durations_s.get(key) for case in cases) for cases in (a, b))
        yield _numbers(name, f"{key}, s", *ranges, relative=DURATION, absolute=least)
    if any(case.streams for case in a):
        yield from _streams(name, a, b)
    for key in _keys(*(case.numbers for case in (*a, *b))):
        first_range, second_range = (_range(case.numbers.get(key) for case in cases) for cases in (a, b))
        yield _number(name, key, first_range, second_range)
    if any(case.track for case in a):
        for key, of in (("fastest climb, m/s", _climb), ("fastest descent, m/s", _descent), ("fastest, m/s", _across)):
            ranges = (_range(_fastest(case, of) for case in cases if case.track) for cases in (a, b))
            yield _numbers(name, key, *ranges, relative=SPEED, absolute=SPEED_M_S)


def _streams(name: str, a: list[Case], b: list[Case]) -> Iterator[Fact]:
    for what, of in (("messages/s", _messages), ("bytes/s", _bytes)):
        ranges = (_range(of(case) for case in cases) for cases in (a, b))
        yield _numbers(name, what, *ranges, relative=TOTAL)
    for kind in _keys(*(case.streams for case in (*a, *b))):
        for place, (what, least) in enumerate((("Hz", FEW_HZ), ("bytes", 0.0))):
            first, second = (_range(case.streams.get(kind, (0.0, 0.0))[place] for case in cases) for cases in (a, b))
            if place == 0 or (first and second and first[0] and second[0]):
                yield _numbers(name, f"{kind}, {what}", first, second, relative=KIND, absolute=least)


def _words(case: str, name: str, first: list[str], second: list[str]) -> Fact:
    """The two agree if they have at least one value in common."""
    one, other = (" or ".join(dict.fromkeys(words)) for words in (first, second))
    return Fact(case, name, one, other, bool(set(first) & set(second)))


def _numbers(
    case: str, name: str, first: Range | None, second: Range | None, *, relative: float = 0.0, absolute: float = 0.0
) -> Fact:
    """The two agree if the ranges of their flights overlap, or are apart by no more than the larger allowance."""
    agrees = (
        first is not None
        and second is not None
        and _gap(first, second) <= max(absolute, relative * max(abs(first[0]), abs(first[1])))
    )
    return Fact(case, name, _shown(first), _shown(second), agrees)


def _gap(first: Range, second: Range) -> float:
    return max(0.0, first[0] - second[1], second[0] - first[1])


def _range(values: Iterable[float | None]) -> Range | None:
    known = [value for value in values if value is not None]
    return (min(known), max(known)) if known else None


def _shown(found: Range | None) -> str:
    if found is None:
        return "-"
    low, high = (f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}" for value in found)
    return low if low == high else f"{low} to {high}"


def _messages(case: Case) -> float:
    return sum(hz for hz, _ in case.streams.values())


def _bytes(case: Case) -> float:
    return sum(hz * size for hz, size in case.streams.values())


def _fastest(case: Case, of: Callable[[tuple[float, ...], tuple[float, ...]], float]) -> float:
    return max((of(p, q) for p, q in itertools.pairwise(case.track)), default=0.0)


def _climb(p: tuple[float, ...], q: tuple[float, ...]) -> float:
    return (q[3] - p[3]) / max(0.1, q[0] - p[0])


def _descent(p: tuple[float, ...], q: tuple[float, ...]) -> float:
    return -_climb(p, q)


def _across(p: tuple[float, ...], q: tuple[float, ...]) -> float:
    return math.dist(p[1:3], q[1:3]) / max(0.1, q[0] - p[0])


def _number(case: str, key: str, first: Range | None, second: Range | None) -> Fact:
    if case == "parameters":
        return _numbers(case, key, first, second)
    if case == "acknowledgement to heartbeat":
        return _numbers(case, key, first, second, absolute=DELAY_S)
    if key.startswith("height"):
        return _numbers(case, key, first, second, relative=0.1, absolute=HEIGHT_M)
    if "speed " in key or " speed" in key:
        return _numbers(case, key, first, second, relative=SPEED, absolute=SPEED_M_S)
    if key.startswith(("changes", "largest jump")):
        return _numbers(case, key, first, second, relative=CHANGES, absolute=FEW_CHANGES)
    if key.startswith("told "):
        return _numbers(case, key, first, second, absolute=FEW_TOLD)
    if key.startswith("battery_pct"):
        return _numbers(case, key, first, second, absolute=BATTERY_PCT)
    if key == "current_a":
        return _numbers(case, key, first, second, relative=CURRENT)
    agrees = first is not None and second is not None
    if first is not None and second is not None:
        agrees = second[0] <= NOISE * max(first[1], _NOTHING) and first[0] <= NOISE * max(second[1], _NOTHING)
    return Fact(case, key, _shown(first), _shown(second), agrees)


_NOTHING = 0.005
"""The least standard deviation that counts: messages carry hundredths and thousandths."""


def _result(case: Case, number: int) -> str:
    if number >= len(case.acks):
        return "-"
    return case.acks[number][1] or "no answer"


def _course(case: Case, what: str) -> str:
    return " ".join(value for _, kind, value in case.events if kind == what) or "-"


def _keys(*facts: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(key for one in facts for key in one))
