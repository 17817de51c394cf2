"""What was measured here beside what the thesis printed: means beside means, and ratios beside ratios."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import mean
from typing import Any

from ...numbers import words
from . import frames, thesis
from .comparison import completed, quotient
from .gallery import SLIPS


@dataclass(frozen=True)
class Pair:
    """A figure as text: measured here (a mean over attempts), and as the thesis has it."""

    here: str
    thesis: str


@dataclass(frozen=True)
class Row:
    """A metric by protocol, and MAVLink's over MQTT-XT's."""

    name: str
    cells: dict[str, Pair]
    ratio: Pair | None


_METRICS: tuple[tuple[str, str, Callable[[float | None], str]], ...] = (
    ("packets", "packets", words.thousands),
    ("bytes", "size_bytes", words.size),
    ("mission time", "mission_s", words.seconds),
)


def rows(metrics: dict[str, Any]) -> list[Row]:
    """Empty where the thesis has no figures of this experiment, or nothing was completed here.

    A ratio to a printed size that is a slip is none of the thesis's.
    """
    printed = thesis.of_scenario(metrics["experiment"])
    sides = {p: completed(side) for p, side in words.sides(metrics) if completed(side)}
    if not printed or not sides:
        return []
    table = []
    for name, field, text in _METRICS:
        here = {p: mean(attempt[field] for attempt in attempts) for p, attempts in sides.items()}
        cells = {p: Pair(text(here[p]), text(printed[field].get(p))) for p in sides}
        is_slip = field == "size_bytes" and any((metrics["experiment"], p) in SLIPS for p in printed[field])
        table.append(Row(name, cells, _ratio(here, {} if is_slip else printed[field])))
    loss = {p: Pair(_loss(attempts), words.share(printed["wire_loss"][p])) for p, attempts in sides.items()}
    return [*table, Row("packets lost", loss, None)]


def _loss(attempts: list[dict[str, Any]]) -> str:
    sent = sum(frames.entered(attempt) for attempt in attempts if attempt["wire_loss"] is not None)
    lost = sum(frames.lost(attempt) for attempt in attempts)
    return words.percent(100 * lost / sent) if lost else "0" if sent else words.NOTHING


def _ratio(here: dict[str, float], printed: dict[str, float]) -> Pair | None:
    made = quotient(printed.get("mavlink"), printed.get("mqttxt"))
    if "mavlink" not in here or "mqttxt" not in here:
        return None
    own = words.ratio(quotient(here["mavlink"], here["mqttxt"]))
    return Pair(f"{own}×", f"{words.ratio(made)}×" if made is not None else words.NOTHING)
