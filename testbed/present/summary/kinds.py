"""A cell of the message set, kind by kind: what each cost with all that ran beside it and alone, took and lost."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from typing import Any

from ...numbers import words
from ..report.comparison import quotient
from .cells import SIDES, Cell
from .losses import Loss
from .numbers import Pair

HEADINGS = (
    *("kind", "arm", "received", "packets, all", "×", "bytes, all", "×", "packets, alone", "×", "bytes, alone", "×"),
    *("delay", "lost"),
)
READING = (
    "MQTT-XT comes first, then MAVLink; × is MAVLink's over MQTT-XT's. Received: calls that the autopilot took, or "
    "values that came in time, of those asked for. All: every frame that entered any link while the kind was on, as "
    "the thesis counts; alone: the kind's own messages, their answers and what acknowledges them. Medians of all "
    "attempts that count; delay: one way by capture, the median of all; lost: messages of which no copy arrived."
)

_KindOf = dict[str, Any]


def kinds_in(attempts: list[dict[str, Any]], form: str) -> list[list[_KindOf]]:
    """Of each attempt of a message set its kinds of a form, command or state."""
    sets = [attempt["message_set"] for attempt in attempts if attempt.get("message_set")]
    return [[kind for kind in one.values() if kind["form"] == form] for one in sets]


def rows_of(cell: Cell) -> list[list[str | Pair]]:
    """A row for each kind, in the order in which they were flown; none where the cell is no message set."""
    sides = {protocol: cell.metrics["protocols"].get(protocol, {"attempts": []})["attempts"] for protocol in SIDES}
    sets = {p: [one["message_set"] for one in attempts if one.get("message_set")] for p, attempts in sides.items()}
    names = dict.fromkeys(name for several in sets.values() for one in several for name in one)
    return [_row(cell, name, {p: [one[name] for one in sets[p] if name in one] for p in SIDES}) for name in names]


def _row(cell: Cell, name: str, sides: dict[str, list[_KindOf]]) -> list[str | Pair]:
    row: list[str | Pair] = [name, cell.arm, _pair(sides, _received)]
    for count in ("with_states", "alone"):
        for unit, text in (("packets", words.thousands), ("bytes", words.size)):
            middles = {p: _middle([float(kind[count][unit]) for kind in sides[p]]) for p in SIDES}
            ratio = quotient(middles["mavlink"], middles["mqttxt"])
            row += [Pair(*(text(middles[p]) for p in SIDES)), words.NOTHING if ratio is None else words.ratio(ratio)]
    return [*row, _pair(sides, _delay), _pair(sides, _lost)]


def _pair(sides: dict[str, list[_KindOf]], text: Callable[[list[_KindOf]], str]) -> Pair:
    return Pair(*(text(sides[protocol]) if sides[protocol] else words.NOTHING for protocol in SIDES))


def _received(kinds: list[_KindOf]) -> str:
    return f"{sum(kind['received'] for kind in kinds):,} of {sum(kind['asked'] for kind in kinds):,}"


def _delay(kinds: list[_KindOf]) -> str:
    return words.milliseconds(_middle([ms for kind in kinds for ms in kind["delay_ms"] if ms is not None]))


def _lost(kinds: list[_KindOf]) -> str:
    return str(Loss(sum(kind["lost"] for kind in kinds), sum(kind["sent"] - kind["open"] for kind in kinds)))


def _middle(values: list[float]) -> float | None:
    return median(values) if values else None
