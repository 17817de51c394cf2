"""A figure: its texts, its drawing at a given width, and its data as a table."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass

from .draw import NARROW, WIDE, Drawing, svg

Value = str | int | float | None


@dataclass(frozen=True)
class Figure:
    """A figure. `name` is its file's name, `shows` describes it in a sentence, `note` says how to read it."""

    name: str
    title: str
    shows: str
    note: str
    draw: Callable[[float], Drawing]
    header: tuple[str, ...]
    rows: tuple[tuple[Value, ...], ...]
    sources: tuple[str, ...] = ()
    """The files of an attempt that it is made from, as `events.jsonl`."""

    def wide(self) -> str:
        return svg(self.draw(WIDE), f"{self.name}-wide", self.title, self.shows)

    def narrow(self) -> str:
        return svg(self.draw(NARROW), f"{self.name}-narrow", self.title, self.shows)

    def csv(self) -> str:
        """The data as CSV: a header, then a line per row; decimal points, and empty cells for missing values."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.header)
        writer.writerows([_plain(value) for value in row] for row in self.rows)
        return text.getvalue()


def _plain(value: Value) -> str:
    return "" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)
