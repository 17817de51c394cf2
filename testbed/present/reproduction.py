"""Whether the headline findings are reproduced: a table on the terminal, `reproduction.json`, and a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from ..fly.results import Series, write_json, write_text
from ..numbers import words
from ..numbers.observed import observe
from ..numbers.reproduction import JudgedLine, judge, verdict_of
from ..numbers.statistics import significant
from ..numbers.written import Metrics
from ..plan import wording
from ..plan.documents import shown
from ..plan.headline import RATIO, Headline, HeadlineCell
from .report.figures.files import write_figure
from .report.figures.margins import margins
from .report.html import environment, path_of_report
from .report.tables import plain_table

DOCUMENT, PAGE = "reproduction.json", "reproduction.html"
VERSION = 1


@dataclass(frozen=True)
class Flown:
    """A cell with its measured series and its judged lines."""

    cell: HeadlineCell
    series: Series
    metrics: Metrics
    judged: tuple[JudgedLine, ...]

    @property
    def uncounted(self) -> list[str]:
        """A line for each attempt that is void or failed."""
        found = []
        for protocol, side in words.sides(self.metrics):
            void = [("void, flown again", one["attempt"], one["reason"]) for one in side["void"]]
            failed = [("failed", a["attempt"], a["reason"]) for a in side["attempts"] if a["status"] == "failed"]
            found += [
                f"{self.cell.name}: {wording.name_of(protocol)}, attempt {number}: {how}: "
                f"{wording.first_line(reason or '')}"
                for how, number, reason in (*failed, *void)
            ]
        return found


def flown_of(cell: HeadlineCell, series: Series, metrics: Metrics, seed: int) -> Flown:
    """Judge a cell by its series."""
    return Flown(cell, series, metrics, tuple(judge(cell, observe(metrics["protocols"]), seed)))


def verdict(flown: Sequence[Flown]) -> str:
    """The verdict over all lines of all cells."""
    return verdict_of([one for cell in flown for one in cell.judged])


def figure_of(judged: JudgedLine, value: float) -> str:
    """A value as text: a ratio, or in the quantity's own unit, as its line has it."""
    return words.digits(value) if judged.line.of == RATIO else judged.quantity.write(value)


def name_of(judged: JudgedLine) -> str:
    """'bytes: MAVLink over MQTT-XT', 'states lost: MAVLink'."""
    of = judged.line.of
    return f"{judged.quantity.name}: {'MAVLink over MQTT-XT' if of == RATIO else wording.name_of(of)}"


def short_name_of(judged: JudgedLine) -> str:
    """The name of a line; for a ratio only the quantity, where that it is a ratio is clear."""
    return judged.quantity.name if judged.line.of == RATIO else name_of(judged)


def basis_of(judged: JudgedLine) -> str:
    """The number of attempts or pairs behind a line, and the attempts without a value."""
    what = wording.plural(len(judged.points), "pair" if judged.line.of == RATIO else "attempt")
    left_out = ", ".join(map(str, judged.missing))
    return f"{what}, without {left_out}" if judged.missing else what


def print_reproduction(headline: Headline, flown: Sequence[Flown], console: Console) -> None:
    """Print a table for each cell, then the attempts that do not count, then the verdict."""
    for one in flown:
        table = plain_table(one.cell.name, "", "published", "margin", "found", "95 % interval", "of", "verdict")
        for judged in one.judged:
            table.add_row(*_cells(judged))
        console.print(table)
    for said in notes_of(flown):
        console.print(said, markup=False, soft_wrap=True)
    console.print(f"\n{verdict(flown)}: {_counted(flown)} (seed {headline.seed})", markup=False, soft_wrap=True)


def notes_of(flown: Sequence[Flown]) -> list[str]:
    """Notes on the verdict: several revisions, and attempts that do not count."""
    revisions = dict.fromkeys(str(one.metrics["revision"]) for one in flown)
    mixed = [f"flown at several revisions: {', '.join(revisions)}"] if len(revisions) > 1 else []
    return [*mixed, *(said for one in flown for said in (*one.metrics["notes"], *one.uncounted))]


def write_reproduction(headline: Headline, flown: Sequence[Flown], folder: Path) -> tuple[Path, Path]:
    """Write `reproduction.json` and a self-contained page, with its figure's data and the figure as PDF next to it.

    Returns the paths of both.
    """
    document, page = folder / DOCUMENT, folder / PAGE
    write_json(document, to_data(headline, flown))
    figure = margins([(one.cell.name, short_name_of(judged), judged) for one in flown for judged in one.judged])
    write_text(
        page,
        environment()
        .get_template("reproduction.html")
        .render(
            verdict=verdict(flown),
            counted=_counted(flown),
            headline=headline,
            table=shown(headline.path),
            flown=flown,
            rows={one.cell.name: [(_cells(judged), judged.line.reason) for judged in one.judged] for one in flown},
            reports={one.cell.name: path_of_report(one.series, page) for one in flown},
            notes=notes_of(flown),
            figure=figure,
            beside=page.stem,
        ),
    )
    write_figure(page, figure)
    return document, page


def to_data(headline: Headline, flown: Sequence[Flown]) -> dict[str, Any]:
    """The content of `reproduction.json`."""
    return {
        "version": VERSION,
        "verdict": verdict(flown),
        "table": shown(headline.path),
        "attempts": headline.attempts,
        "seed": headline.seed,
        "notes": notes_of(flown),
        "cells": [
            {
                "experiment": one.cell.plan.experiment,
                "arm": one.cell.plan.label,
                "profile": one.cell.plan.profile.name,
                "series": one.series.path.name,
                "revision": one.metrics["revision"],
                "lines": [_line(judged) for judged in one.judged],
            }
            for one in flown
        ],
    }


def _line(judged: JudgedLine) -> dict[str, Any]:
    line, found = judged.line, judged.estimate
    return {
        "quantity": line.quantity,
        "of": line.of,
        "unit": "ratio" if line.of == RATIO else judged.quantity.unit,
        "expected": line.expected,
        "margin": list(line.margin),
        "reason": line.reason,
        "points": {str(number): significant(value) for number, value in judged.points.items()},
        "missing": list(judged.missing),
        "found": found.value if found is not None else None,
        "interval": [found.low, found.high] if found is not None else None,
        "verdict": judged.verdict,
    }


def _cells(judged: JudgedLine) -> list[str]:
    found = judged.estimate
    return [
        name_of(judged),
        figure_of(judged, judged.line.expected),
        _between(judged, *judged.line.margin),
        words.NOTHING if found is None else figure_of(judged, found.value),
        words.NOTHING if found is None else _between(judged, found.low, found.high),
        basis_of(judged),
        judged.verdict,
    ]


def _between(judged: JudgedLine, low: float, high: float) -> str:
    return f"{figure_of(judged, low)} to {figure_of(judged, high)}"


def _counted(flown: Sequence[Flown]) -> str:
    judged = [one for cell in flown for one in cell.judged]
    done = sum(one.verdict == "reproduced" for one in judged)
    return f"{done} of {wording.plural(len(judged), 'line')} reproduced"
