"""The command: the summary's page, or its tables in a document."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import ResultsError
from ..topology import ROOT
from .cells import find_cells
from .markdown import fill

RESULTS = ROOT / "results"
DOCUMENT = ROOT / "docs" / "results.md"


def summary(
    results: Annotated[list[Path] | None, typer.Argument(help="Results folders; none: results/.")] = None,
    markdown: Annotated[Path, typer.Option(help="The document between whose markers the tables go.")] = DOCUMENT,
) -> None:
    """Set all experiments, arms and profiles beside each other, in the tables of a Markdown document."""
    roots = results or [RESULTS]
    found = find_cells(roots)
    for said in found.unread:
        typer.echo(f"not counted: {said}", err=True)
    if not found.cells:
        raise ResultsError(f"{', '.join(map(str, roots))}: expected a finished series in it")
    typer.echo(f"{markdown}: {', '.join(fill(markdown, found.cells))}")
