"""The command `testbed all`: flies everything, or resumes an interrupted run."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from net.link_plan import SHAPERS

from ..errors import DockerError, Interrupted, SchedulerEnded
from ..fly.campaign.run import fly_all
from ..fly.campaign.targets import CERTIFICATE, Wish, plans_of
from ..fly.flights import check_settings
from ..fly.only_run import only_run
from ..fly.progress import ConsoleProgress
from ..fly.results import Series
from ..fly.runner import Begun, run_series, signals_interrupt
from ..fly.validity import Verdict
from ..plan.experiments import ARMS, DEFAULT_COUNT, DEFAULT_SAMPLES, EXPERIMENTS, Plan
from ..plan.machines import refuse_machines
from ..present.reporting import RESULTS, make_console, report_series, reported_without_docker
from ..present.summary.cells import find_cells
from ..present.summary.page import PAGE, write_summary
from .machines import STEPS, quiet


def fly_everything(
    attempts: Annotated[str, typer.Option(help="How often each, over each protocol.")] = "1",
    experiments: Annotated[str, typer.Option(help=f"A list; empty: {','.join(EXPERIMENTS)}.")] = "",
    arms: Annotated[str, typer.Option(help=f"A list; empty: {','.join(ARMS)}.")] = "",
    profiles: Annotated[str, typer.Option(help="A list; empty: all of `testbed profiles`.")] = "",
    samples: Annotated[str, typer.Option(help="Scenario 4: values of each series.")] = str(DEFAULT_SAMPLES),
    count: Annotated[str, typer.Option(help="messages: how many of each kind.")] = str(DEFAULT_COUNT),
    shaper: Annotated[str, typer.Option(help=f"What shapes the links: {', '.join(SHAPERS)}.")] = SHAPERS[0],
    scheduler: Annotated[str, typer.Option(help="On many machines: a scheduler's address, tls://HOST:PORT.")] = "",
    certificate: Annotated[Path, typer.Option(help="On many machines: the campaign's certificate.")] = Path(
        CERTIFICATE
    ),
    results: Annotated[Path, typer.Option(help="Folder for the results.")] = RESULTS,
) -> None:
    """Fly all experiments in all arms on all profiles; what is in the results folder is not flown again.

    Broken off, it goes on where it stopped. Exit code 0 if every attempt counts, completed or failed.
    """
    refuse_machines(os.environ, "a campaign")
    named = {name.lower(): os.environ.get(name, "") for name in ("FLEET", "FOGS", "DRONES")}
    wish = Wish(
        attempts,
        experiments,
        arms,
        profiles,
        samples,
        count,
        shaper,
        **named,
        scheduler=scheduler,
        certificate=str(certificate),
    )
    plans = plans_of(wish)
    check_settings(plans)
    console = make_console()
    root = results.absolute()
    campaign = _on_machines(scheduler, certificate) if scheduler else _here
    again = f"to go on, type: {wish.typed()}"
    try:
        with signals_interrupt("what was flown is kept"):
            counted = campaign(plans, root, console)
    except (Interrupted, DockerError, SchedulerEnded) as error:
        _write_page(root, console)
        raise type(error)(f"{error}\n{again}") from None
    _write_page(root, console)
    if not counted:
        console.print(again, markup=False, soft_wrap=True)
        raise typer.Exit(1)


def _here(plans: Sequence[Plan], root: Path, console: Console) -> bool:
    """Fly a campaign on this machine alone."""
    only_run()
    return fly_here(plans, root, console)


def fly_here(plans: Sequence[Plan], root: Path, console: Console) -> bool:
    """As `fly_all`; each series is reported once it was flown."""

    def fly(plan: Plan, series: Series, begun: dict[int, Begun]) -> list[Verdict]:
        with reported_without_docker(series, console):
            return run_series(plan, series, ConsoleProgress(console), begun=begun)

    return fly_all(plans, root, console, fly, lambda path: report_series(path, console))


def _on_machines(address: str, certificate: Path) -> Callable[[Sequence[Plan], Path, Console], bool]:
    """Fly a campaign on a scheduler's workers; Dask is only imported here. Raises UserError if no scheduler answers."""
    from ..fly.campaign.certificate import check_scheduler, security_of
    from ..fly.campaign.machines import fly_on_machines

    quiet()
    security = security_of(certificate)
    check_scheduler(address, security)
    return lambda plans, root, console: fly_on_machines(plans, root, console, STEPS, address, security)


def _write_page(root: Path, console: Console) -> None:
    """Write the summary of the results folder, if any series in it is finished."""
    if root.is_dir() and (found := find_cells([root])).cells:
        write_summary(found, root / PAGE, EXPERIMENTS)
        console.print(f"summary: {root / PAGE}", markup=False, soft_wrap=True)
