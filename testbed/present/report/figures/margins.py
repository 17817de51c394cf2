"""Measured beside published figures: each line's interval and its margin, all divided by the published figure."""

from __future__ import annotations

from collections.abc import Sequence

from ....numbers.reproduction import JudgedLine
from .axes import Scale, bottom, decades, log_bounds
from .draw import TEXT, Drawing
from .figure import Figure, Value

_LINE, _HEAD = 22.0, 30.0


def margins(lines: Sequence[tuple[str, str, JudgedLine]]) -> Figure:
    """The figure of (cell, name, judged line); lines published as 0 do not fit the scale and are only in the data."""
    table: list[tuple[Value, ...]] = []
    for cell, name, judged in lines:
        found = judged.estimate
        edges = (found.value, found.low, found.high) if found is not None else (None, None, None)
        table.append((cell, name, judged.line.expected, *judged.line.margin, *edges, judged.verdict))
    return Figure(
        name="reproduction",
        title="Found over published",
        shows="Each line's mean, its 95 % bootstrap interval, and the margin in which it counts as the same.",
        note="Grey: the margin. Line and dot: the interval and the mean that were found; hollow where it is not "
        "reproduced. Everything is divided by the published figure, which is at 1; lines published as 0 are left out.",
        draw=lambda width: _draw(lines, width),
        header=("cell", "line", "published", "margin from", "margin to", "found", "from", "to", "verdict"),
        rows=tuple(table),
    )


def _draw(lines: Sequence[tuple[str, str, JudgedLine]], width: float) -> Drawing:
    scaled = [(cell, name, judged) for cell, name, judged in lines if judged.line.expected > 0]
    cells = list(dict.fromkeys(cell for cell, _, _ in scaled))
    narrow = width < 600
    left = 8.0 if narrow else 300.0
    row = 2 * _LINE if narrow else _LINE
    drawing = Drawing(width, 16 + _HEAD * len(cells) + row * len(scaled) + 26)
    low, high = log_bounds([edge for _, _, judged in scaled for edge in _edges(judged)], 0.01)
    across = Scale(low, high, left, width - 16, logarithmic=True)
    base = drawing.height - 26
    bottom(drawing, across, decades(low, high, lambda v: f"{v:g}"), base, 12)
    drawing.line((across(1), 8), (across(1), base), "faint", 1.4)
    y = 16.0
    for cell in cells:
        y += _HEAD
        drawing.text(6, y - 12, cell, "ink", size=TEXT)
        for _, name, judged in (one for one in scaled if one[0] == cell):
            drawing.text(6, y + 4, name, "ink", size=TEXT - 0.5)
            _one(drawing, across, judged, y + (_LINE if narrow else 0))
            y += row
    return drawing


def _one(drawing: Drawing, across: Scale, judged: JudgedLine, y: float) -> None:
    expected, found = judged.line.expected, judged.estimate
    low, high = (across(edge / expected) for edge in judged.line.margin)
    drawing.line((low, y), (max(high, low + 1), y), "faint", 11)
    if found is None:
        return
    low, value, high = (across(v / expected) for v in (found.low, found.value, found.high))
    side = judged.line.of if judged.line.of != "ratio" else "mqttxt"
    drawing.line((low, y), (high, y), "ink", 1.6)
    tip = f"{found.value:g} ({found.low:g} to {found.high:g}), published {expected:g}: {judged.verdict}"
    drawing.dot((value, y), side, 4, hollow=judged.verdict != "reproduced", tip=tip)


def _edges(judged: JudgedLine) -> list[float]:
    found = judged.estimate
    edges = [*judged.line.margin, *((found.low, found.high) if found is not None else ())]
    return [edge / judged.line.expected for edge in edges]
