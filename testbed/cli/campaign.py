"""The command: fly everything, or go on where that was broken off."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from net.link_plan import SHAPERS

from ..errors import DockerError
from ..fly.campaign.run import fly_all
from ..fly.campaign.targets import Wish, plans_of
from ..fly.flights import settings_of
from ..fly.only_run import only_run
from ..fly.progress import ConsoleProgress
from ..fly.results import Series
from ..fly.runner import Begun, Interrupted, run_series, signals_interrupt
from ..fly.validity import Verdict
from ..plan.experiments import ARMS, DEFAULT_COUNT, DEFAULT_SAMPLES, EXPERIMENTS, PROTOCOLS, Plan
from ..present.reporting import RESULTS, make_console, report_series, reported_without_docker
from ..present.summary.cells import find_cells
from ..present.summary.page import PAGE, write_summary


def fly_everything(
    attempts: Annotated[str, typer.Option(help="How often each, over each protocol.")] = "1",
    experiments: Annotated[str, typer.Option(help=f"A list; empty: {','.join(EXPERIMENTS)}.")] = "",
    arms: Annotated[str, typer.Option(help=f"A list; empty: {','.join(ARMS)}.")] = "",
    profiles: Annotated[str, typer.Option(help="A list; empty: all of `testbed profiles`.")] = "",
    samples: Annotated[str, typer.Option(help="Scenario 4: values of each series.")] = str(DEFAULT_SAMPLES),
    count: Annotated[str, typer.Option(help="messages: how many of each kind.")] = str(DEFAULT_COUNT),
    shaper: Annotated[str, typer.Option(help=f"What shapes the links: {', '.join(SHAPERS)}.")] = SHAPERS[0],
    results: Annotated[Path, typer.Option(help="Folder for the results.")] = RESULTS,
) -> None:
    """Fly all experiments in all arms on all profiles; what is in the results folder is not flown again.

    Broken off, it goes on where it stopped. Exit code 0 if every attempt counts, completed or failed.
    """
    named = {name.lower(): os.environ.get(name, "") for name in ("FLEET", "FOGS", "DRONES")}
    wish = Wish(attempts, experiments, arms, profiles, samples, count, shaper, **named)
    plans = plans_of(wish)
    for plan in plans:
        for protocol in PROTOCOLS:
            settings_of(plan, protocol)  # its errors are raised before anything is written
    only_run()
    console = make_console()

    def fly(plan: Plan, series: Series, begun: dict[int, Begun]) -> list[Verdict]:
        with reported_without_docker(series, console):
            return run_series(plan, series, ConsoleProgress(console), begun=begun)

    root = results.absolute()
    again = f"to go on, type: {wish.typed()}"
    try:
        with signals_interrupt("what was flown is kept"):
            counted = fly_all(plans, root, console, fly, lambda path: report_series(path, console))
    except (Interrupted, DockerError) as error:
        _write_page(root, console)
        raise type(error)(f"{error}\n{again}") from None
    _write_page(root, console)
    if not counted:
        console.print(again, markup=False, soft_wrap=True)
        raise typer.Exit(1)


def _write_page(root: Path, console: Console) -> None:
    """The summary of everything in the results folder, where anything is finished."""
    if root.is_dir() and (found := find_cells([root])).cells:
        write_summary(found, root / PAGE, EXPERIMENTS)
        console.print(f"summary: {root / PAGE}", markup=False, soft_wrap=True)
