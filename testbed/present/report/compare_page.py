"""The comparison of two results, on the terminal and as a page."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from ...fly.results import write_text
from ...numbers import words
from ...plan import wording
from . import compare
from .compare import ComparedSeries
from .figures.compared import compared
from .figures.files import write_figure
from .html import environment, path_of_report
from .message_set import is_message_set
from .tables import plain_table


def print_comparison(first: ComparedSeries, second: ComparedSeries, console: Console) -> None:
    """Print both results' titles, the conditions in which they differ, and every metric of both."""
    console.print()
    for one in (first, second):
        console.print(f"{one.name}: {compare.title(one)}", soft_wrap=True, markup=False)
    for said in compare.sentences(first, second):
        console.print(said, soft_wrap=True, markup=False)
    differing = [c for c in compare.conditions(first, second) if c.differs]
    if differing:
        table = plain_table("differs", "", "A", "B")
        for condition in differing:
            table.add_row(condition.name, condition.first or words.NOTHING, condition.second or words.NOTHING)
        console.print(table)
    rows = compare.rows(first, second)
    for protocol in dict.fromkeys(row.protocol for row in rows):
        table = plain_table(wording.name_of(protocol), "")
        for heading in ("A", "B", "change"):
            table.add_column(heading, justify="right")
        for row in rows:
            if row.protocol == protocol:
                said = compare.change(row.change) if row.change is not None else words.NOTHING
                table.add_row(row.name, row.first.text, row.second.text, said)
        console.print(table)


def write_comparison(first: ComparedSeries, second: ComparedSeries, target: Path) -> None:
    """Write a self-contained page, and next to it its figure's data (`.csv`) and the figure for papers (`.pdf`).

    Links to the two reports are relative to the page.
    """
    rows = compare.rows(first, second)
    figure = compared(rows)
    target.parent.mkdir(parents=True, exist_ok=True)
    page = (
        environment()
        .get_template("compare.html")
        .render(
            results=[
                {"name": one.name, "title": compare.title(one), "report": path_of_report(one.series, target)}
                for one in (first, second)
            ],
            sentences=compare.sentences(first, second),
            conditions=compare.conditions(first, second),
            names=list(dict.fromkeys(row.name for row in rows)),
            rows={(row.name, row.protocol): row for row in rows},
            protocols=list(dict.fromkeys(row.protocol for row in rows)),
            change=compare.change,
            for_one_message=is_message_set(first.metrics),
            figure=figure,
            beside=target.stem,
        )
    )
    write_text(target, page)
    if figure is not None:
        write_figure(target, figure)
