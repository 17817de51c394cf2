"""Small multiples: a panel per kind, five side by side, or two if the width is small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .axes import legend
from .draw import Drawing

LEFT, GAP, TOP = 52.0, 16.0, 48.0


@dataclass(frozen=True)
class Panel:
    """The place of a kind's panel: left, top, width and height, and whether it is the first in its line."""

    name: str
    x: float
    y: float
    wide: float
    high: float
    first: bool


def lay_out(names: Sequence[str], width: float, high: float, below: float, left: float = LEFT) -> list[Panel]:
    """Place the panels. `high` is each one's height, `below` the room under it for its axis and the next one's name."""
    columns = 2 if width < 600 else 5
    wide = (width - left - (columns - 1) * GAP - 4) / columns
    return [
        Panel(
            name,
            left + (place % columns) * (wide + GAP),
            TOP + (place // columns) * (high + below),
            wide,
            high,
            place % columns == 0,
        )
        for place, name in enumerate(names)
    ]


def begin(panels: Sequence[Panel], protocols: Sequence[str], width: float, below: float) -> Drawing:
    """A drawing as tall as the panels need, with the legend on top and each panel's name above it."""
    last = panels[-1]
    drawing = Drawing(width, last.y + last.high + below - 16)
    legend(drawing, protocols)
    for panel in panels:
        drawing.text(panel.x, panel.y - 8, panel.name, "ink", bold=True)
    return drawing
