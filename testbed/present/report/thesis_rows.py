"""The measurements here beside the thesis's figures: means beside means, and ratios beside ratios."""

from __future__ import annotations

from dataclasses import dataclass

from ...numbers import words
from ...numbers.observed import observe
from ...numbers.quantities import FRAMES_LOST, MISSION, PACKETS, SIZE
from ...numbers.quantity import QuantityFigure, quotient
from ...numbers.written import Metrics
from . import thesis
from .gallery import SLIPS


@dataclass(frozen=True)
class ThesisPair:
    """A figure as text: measured here (a mean over attempts), and from the thesis."""

    here: str
    thesis: str


@dataclass(frozen=True)
class ThesisRow:
    """A metric by protocol, and the ratio of MAVLink's to MQTT-XT's."""

    name: str
    cells: dict[str, ThesisPair]
    ratio: ThesisPair | None


_QUANTITIES = (PACKETS, SIZE, MISSION)


def rows(metrics: Metrics) -> list[ThesisRow]:
    """The rows; empty if the thesis has no figures for this experiment and fleet size, or nothing was completed here.

    A printed size that is a slip (SLIPS) makes no ratio for the thesis.
    """
    printed = thesis.of_scenario(metrics["experiment"])
    sides = {p: side for p, side in observe(metrics["protocols"]).items() if side.completed}
    if not printed or not sides or not thesis.flew_alike(metrics):
        return []
    table = []
    for quantity in _QUANTITIES:
        here = {p: quantity.figure(side).mean for p, side in sides.items()}
        theirs = printed[quantity.key]
        cells = {p: ThesisPair(quantity.write(here[p]), quantity.write(theirs.get(p))) for p in sides}
        is_slip = quantity is SIZE and any((metrics["experiment"], p) in SLIPS for p in theirs)
        table.append(ThesisRow(quantity.name, cells, _ratio(here, {} if is_slip else theirs)))
    lost = {p: FRAMES_LOST.figure(side) for p, side in sides.items()}
    loss = {p: ThesisPair(_share(lost[p]), words.share(printed[FRAMES_LOST.key][p])) for p in sides}
    return [*table, ThesisRow("packets lost", loss, None)]


def _share(lost: QuantityFigure) -> str:
    return "0" if lost.value == 0 else words.share(lost.value)


def _ratio(here: dict[str, float | None], printed: dict[str, float]) -> ThesisPair | None:
    made = quotient(printed.get("mavlink"), printed.get("mqttxt"))
    if "mavlink" not in here or "mqttxt" not in here:
        return None
    own = words.ratio(quotient(here["mavlink"], here["mqttxt"]))
    return ThesisPair(f"{own}×", f"{words.ratio(made)}×" if made is not None else words.NOTHING)
