"""A figure: what it shows, how it is drawn at a width, and its data as a table."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass

from .draw import NARROW, WIDE, Drawing, svg

Value = str | int | float | None


@dataclass(frozen=True)
class Figure:
    """`name` is its file's name, `shows` says in a sentence what one sees, `note` what to know to read it."""

    name: str
    title: str
    shows: str
    note: str
    draw: Callable[[float], Drawing]
    header: tuple[str, ...]
    rows: tuple[tuple[Value, ...], ...]
    sources: tuple[str, ...] = ()
    """Which files of an attempt it is made from, as `events.jsonl`."""

    def wide(self) -> str:
        return svg(self.draw(WIDE), f"{self.name}-wide", self.title, self.shows)

    def narrow(self) -> str:
        return svg(self.draw(NARROW), f"{self.name}-narrow", self.title, self.shows)

    def csv(self) -> str:
        """Its data: a header, then a line a row; numbers with a point, nothing where there is no value."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.header)
        writer.writerows([_plain(value) for value in row] for row in self.rows)
        return text.getvalue()


def _plain(value: Value) -> str:
    return "" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)
