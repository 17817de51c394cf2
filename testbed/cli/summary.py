"""The command `testbed summary`: the summary's page, or its tables in a document."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import ResultsError
from ..plan.experiments import EXPERIMENTS
from ..present.reporting import RESULTS
from ..present.summary.cells import find_cells
from ..present.summary.markdown import fill
from ..present.summary.page import PAGE, write_summary


def summary(
    results: Annotated[list[Path] | None, typer.Argument(help="Results folders; none: results/.")] = None,
    html: Annotated[Path | None, typer.Option(help="Where the page goes; else in the first folder.")] = None,
    markdown: Annotated[Path | None, typer.Option(help="No page: the tables between this document's markers.")] = None,
) -> None:
    """Set all experiments, arms and profiles beside each other: a page, or tables in a Markdown document."""
    roots = results or [RESULTS]
    found = find_cells(roots)
    for said in found.unread:
        typer.echo(f"not counted: {said}", err=True)
    if not found.cells:
        raise ResultsError(f"{', '.join(map(str, roots))}: expected a finished series in it")
    if markdown is not None:
        typer.echo(f"{markdown}: {', '.join(fill(markdown, found.cells))}")
    if html is not None or markdown is None:
        target = html or roots[0] / PAGE
        write_summary(found, target, EXPERIMENTS)
        typer.echo(f"page: {target}")
