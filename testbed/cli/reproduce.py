"""The command `testbed reproduce`: flies the headline table and judges whether its findings are reproduced."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..errors import DockerError, Interrupted, ResultsError
from ..fly.flights import check_settings
from ..fly.manifest import revision
from ..fly.only_run import only_run
from ..fly.runner import signals_interrupt
from ..numbers.reproduction import REPRODUCED
from ..plan.headline import HEADLINE, Headline, read_headline
from ..plan.machines import refuse_machines
from ..plan.overrides import suffix
from ..present.reporting import RESULTS, make_console, shown_path
from ..present.reproduction import Flown, flown_of, print_reproduction, verdict, write_reproduction
from ..present.summary.cells import find_cells
from .campaign import fly_here

FOLDER = RESULTS / "reproduction"


def reproduce(
    attempts: Annotated[str, typer.Option(help="How often each cell, over each protocol; empty: the table's.")] = "",
    seed: Annotated[str, typer.Option(help="Draws who flies first, and the resamples; empty: the table's.")] = "",
    table: Annotated[Path, typer.Option(help="The cells, their lines and margins.")] = HEADLINE,
    results: Annotated[Path, typer.Option(help="Folder for the results.")] = FOLDER,
    fly: Annotated[bool, typer.Option("--fly/--no-fly", help="Judge alone what was flown before.")] = True,
) -> None:
    """Fly the headline table and say whether its findings were reproduced; broken off, it goes on where it stopped.

    Exit code 0 if every line is reproduced, 1 if one is not or is undecided.
    """
    refuse_machines(os.environ, "testbed reproduce")
    headline = read_headline(table, attempts, seed)
    console, root = make_console(), results.absolute()
    if fly:
        _fly(headline, root, console, f"to go on, type: {_typed(attempts, seed)}")
    flown = _judged(headline, root)
    print_reproduction(headline, flown, console)
    for said in _of_others(flown):
        console.print(said, markup=False, soft_wrap=True)
    for path in write_reproduction(headline, flown, root):
        console.print(f"{path.suffix[1:]}: {shown_path(path)}", markup=False, soft_wrap=True)
    if verdict(flown) != REPRODUCED:
        raise typer.Exit(1)


def _fly(headline: Headline, root: Path, console: Console, again: str) -> None:
    plans = [cell.plan for cell in headline.cells]
    check_settings(plans)
    only_run()
    try:
        with signals_interrupt("what was flown is kept"):
            fly_here(plans, root, console)
    except (Interrupted, DockerError) as error:
        raise type(error)(f"{error}\n{again}") from None


def _judged(headline: Headline, root: Path) -> list[Flown]:
    """Judge each cell by its newest measured series, a whole one if any. Raises ResultsError if a cell has none."""
    measured = {(one.experiment, one.arm, one.profile): one for one in find_cells([root], headline.attempts).cells}
    found = []
    for cell in headline.cells:
        name = cell.plan.experiment, cell.plan.label + suffix(os.environ), cell.plan.profile.name
        if name not in measured:
            raise ResultsError(f"{shown_path(root)}: {cell.name}: expected a measured series; fly it without --no-fly")
        found.append(flown_of(cell, measured[name].series, measured[name].metrics, headline.seed))
    return found


def _of_others(flown: list[Flown]) -> list[str]:
    """A line for each cell that was flown at another revision than is here: a finished series is not flown again."""
    here = revision()["commit"]
    cells = {one.cell.name: one.metrics["revision"] for one in flown}
    return [
        f"{name}: flown at {at[:12]}, not at {here[:12]}, which is here; another folder in --results flies it anew"
        for name, at in cells.items()
        if here is not None and at is not None and at != here
    ]


def _typed(attempts: str, seed: str) -> str:
    changed = [f"{name}={value}" for name, value in (("ATTEMPTS", attempts), ("SEED", seed)) if value]
    return " ".join(["make reproduce", *changed])
