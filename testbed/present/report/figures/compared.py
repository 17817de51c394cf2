"""Two results as points: every attempt over the median of the first result."""

from __future__ import annotations

from collections.abc import Sequence

from ....plan import wording
from ..compare import ComparedMetric
from .axes import Scale, bottom, decades, steps
from .draw import TEXT, Drawing
from .figure import Figure, Value


def compared(rows: Sequence[ComparedMetric]) -> Figure | None:
    """The figure of the comparison; None if no metric has a value in both results."""
    drawn = [row for row in rows if row.change is not None and row.first.value]
    if not drawn:
        return None
    table: list[tuple[Value, ...]] = []
    for row in drawn:
        for name, cell in (("A", row.first), ("B", row.second)):
            table += [(row.name, row.protocol, name, number, point) for number, point in enumerate(cell.points, 1)]
    return Figure(
        name="compare",
        title="B over A",
        shows="Every attempt of both results over the median of A, by metric and protocol.",
        note="Hollow: attempts of A. Filled: attempts of B. Everything is divided by A's median, which is at 1.",
        draw=lambda width: _draw(drawn, width),
        header=("metric", "protocol", "result", "attempt", "value"),
        rows=tuple(table),
    )


def _draw(rows: list[ComparedMetric], width: float) -> Drawing:
    narrow = width < 600
    line, top, left = 22.0, 24.0, 150.0 if narrow else 230.0
    drawing = Drawing(width, top + line * len(rows) + 24)
    shares = [point / (row.first.value or 1) for row in rows for c in (row.first, row.second) for point in c.points]
    low, high = min([*shares, 0.8]), max([*shares, 1.25])
    if high / max(low, 1e-9) > 8:
        power_low, power_high = _decade(low, up=False), _decade(high, up=True)
        across = Scale(power_low, power_high, left, width - 14, logarithmic=True)
        ticks = decades(power_low, power_high, lambda v: f"{v:g}", 4)
    else:
        across = Scale(0, 1.05 * high, left, width - 14)
        ticks = steps(1.05 * high, lambda v: f"{v:g}", 5)
    base = top + line * len(rows) - 6
    bottom(drawing, across, ticks, base, top - 8)
    drawing.line((across(1), top - 12), (across(1), base), "faint", 1.4)
    for number, row in enumerate(rows):
        y = top + line * number + 4
        name = row.name.replace("packets per second", "packets/s").replace("bytes per second", "bytes/s")
        drawing.dot((6, y - 4), row.protocol, 3.4)
        drawing.text(16, y, name if narrow else f"{wording.name_of(row.protocol)}: {row.name}", "ink", size=TEXT - 0.5)
        for cell, hollow in ((row.first, True), (row.second, False)):
            for point in cell.points:
                at = (across(point / (row.first.value or 1)), y - 4)
                drawing.dot(at, row.protocol, 3.8, hollow=hollow, tip=f"{'A' if hollow else 'B'}: {point:g}")
    return drawing


def _decade(value: float, up: bool) -> float:
    """The power of ten at or beyond a value."""
    power = 1.0
    while power > value and not up:
        power /= 10
    while power < value and up:
        power *= 10
    return power
