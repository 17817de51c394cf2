"""The `testbed` command."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Column, Table

from mqttxt.cli.one_line import OneLineErrors
from net.link_plan import SHAPERS

from ..errors import TestbedError, UserError
from ..fly.containers import Containers
from ..fly.flights import check_settings
from ..fly.link_check import check_profiles
from ..fly.machines.spread import containers_on
from ..fly.only_run import only_run
from ..fly.page_process import page_port, page_url
from ..fly.progress import ConsoleProgress
from ..fly.results import new_series, open_series
from ..fly.runner import run_series, signals_interrupt, signals_wait
from ..numbers.metrics import measure_series, read_metrics, verdict
from ..plan.experiments import ARMS, DEFAULT_COUNT, DEFAULT_SAMPLES, EXPERIMENTS, Plan, make_plan, on_machines
from ..plan.factors import FACTORS
from ..plan.fleets import fleet_of
from ..plan.machines import refuse_machines
from ..plan.overrides import files_of_standard_fleet, suffix
from ..present.report.compare import result_of
from ..present.report.compare_page import print_comparison, write_comparison
from ..present.reporting import RESULTS, make_console, report_series, reported_without_docker, shown_path
from . import profiles as profiles
from .campaign import fly_everything
from .live import PROFILE_HELP, SHAPER_HELP, down, factor_help, link, page, up
from .machines import certificate, scheduler, worker
from .packets import packets
from .reproduce import reproduce
from .summary import summary

app = typer.Typer(
    name="testbed",
    cls=OneLineErrors,
    help="Flies the same mission over MQTT-XT and MAVLink on the same links, and shows what went over them.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.command()
def run(
    experiment: Annotated[str, typer.Argument(help=f"What to fly: {', '.join(EXPERIMENTS)}.")],
    attempts: Annotated[str, typer.Option(help="How often.")] = "1",
    arm: Annotated[str, typer.Option(help=f"How the fleet talks: {', '.join(ARMS)}.")] = "thesis",
    profile: Annotated[str, typer.Option(help=PROFILE_HELP)] = "ideal",
    shaper: Annotated[str, typer.Option(help=SHAPER_HELP)] = SHAPERS[0],
    protocols: Annotated[str, typer.Option(help="Over what, a list; empty: mqttxt,mavlink.")] = "",
    streams: Annotated[str, typer.Option(help=factor_help("streams"))] = "",
    commanding: Annotated[str, typer.Option(help=factor_help("commanding"))] = "",
    qos: Annotated[str, typer.Option(help=factor_help("qos"))] = "",
    chain: Annotated[str, typer.Option(help=factor_help("chain"))] = "",
    states: Annotated[str, typer.Option(help=factor_help("states"))] = "",
    security: Annotated[str, typer.Option(help=factor_help("security"))] = "",
    station: Annotated[str, typer.Option(help=factor_help("station"))] = "",
    tcp: Annotated[str, typer.Option(help=factor_help("tcp"))] = "",
    air: Annotated[str, typer.Option(help=factor_help("air"))] = "",
    samples: Annotated[str, typer.Option(help="Scenario 4: values of each series.")] = str(DEFAULT_SAMPLES),
    count: Annotated[str, typer.Option(help="messages: how many of each kind.")] = str(DEFAULT_COUNT),
    page: Annotated[bool, typer.Option("--page", help="Show the flights on the live page; they do not count.")] = False,
    results: Annotated[Path, typer.Option(help="Folder for the results.")] = RESULTS,
) -> None:
    """Fly an experiment, measure it, and write its report. Exit code 0 only if every attempt was completed."""
    with _errors_as_lines():
        factors = {"streams": streams, "commanding": commanding, "qos": qos, "chain": chain, "states": states}
        factors |= {"security": security, "station": station, "tcp": tcp, "air": air}
        plan = make_plan(
            experiment, attempts, arm, profile, protocols, factors, shaper, samples, count, fleet_of(os.environ)
        )
        _run(on_machines(replace(plan, page=page_port() if page else None), os.environ), results)


@app.command()
def fly(
    mission: Annotated[str, typer.Argument(help="A Python file with `async def mission(fleet, steps)`.")],
    attempts: Annotated[str, typer.Option(help="How often.")] = "1",
    arm: Annotated[str, typer.Option(help=f"How the fleet talks: {', '.join(ARMS)}.")] = "thesis",
    profile: Annotated[str, typer.Option(help=PROFILE_HELP)] = "ideal",
    protocols: Annotated[str, typer.Option(help="Over what, a list; empty: mqttxt,mavlink.")] = "",
    results: Annotated[Path, typer.Option(help="Folder for the results.")] = RESULTS,
) -> None:
    """Fly a mission of your own, as `run` flies a scenario."""
    with _errors_as_lines():
        if not mission.endswith(".py"):
            raise UserError(f"{mission}: expected a Python file, or for a scenario: testbed run {mission}")
        plan = make_plan(mission, attempts, arm, profile, protocols, fleet=fleet_of(os.environ))
        _run(on_machines(plan, os.environ), results)


@app.command()
def report(
    results: Annotated[list[Path], typer.Argument(help="Folders of series, as results/scenario-1/latest.")],
) -> None:
    """Make metrics and report again, from the results folder alone."""
    with _errors_as_lines():
        for path in results:
            open_series(path)  # its error is raised before anything is written
        for path in results:
            report_series(path, make_console())


@app.command(name="verdict")
def judge(
    results: Annotated[Path, typer.Argument(help="Folder of a series, as results/scenario-1/latest.")],
    require: Annotated[list[str], typer.Option(help="What must hold, as 'ratios.packets>=50'; may be repeated.")],
) -> None:
    """Say whether a series meets requirements, for CI. Exit code 0 if all are met, 1 if not, 2 for a wrong path."""
    with _errors_as_lines():
        wanted = [verdict.parse(text) for text in require]
        series = open_series(results)
        metrics = read_metrics(series)
        answers = [verdict.judge(metrics, requirement) for requirement in wanted]
        for answer in answers:
            typer.echo(str(answer))
        if not all(answer.met for answer in answers):
            raise typer.Exit(1)


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(help="A: the folder of a series, as results/scenario-1/latest.")],
    second: Annotated[Path, typer.Argument(help="B: another one.")],
    html: Annotated[Path, typer.Option(help="Where the page goes.")] = RESULTS / "compare.html",
) -> None:
    """Set two results beside each other, and say in what they differ."""
    with _errors_as_lines():
        both = [open_series(path) for path in (first, second)]
        results = [result_of(name, one, measure_series(one)) for name, one in zip("AB", both, strict=True)]
        console = make_console()
        print_comparison(results[0], results[1], console)
        write_comparison(results[0], results[1], html)
        console.print(f"page: {shown_path(html)}", soft_wrap=True, markup=False)


@app.command()
def arms() -> None:
    """Say which arms there are, what each sets the factors to, and what else they can be."""
    names = [Column(name, no_wrap=True) for name in ("", *ARMS)]
    table = Table(*names, "can be", box=None, pad_edge=False, header_style="bold")
    for name, values in FACTORS.items():
        own = [str(getattr(arm.factors, name)) for arm in ARMS.values()]
        table.add_row(name.upper(), *own, ", ".join(values))
    make_console().print(table)


@app.command()
def links(
    profiles: Annotated[str, typer.Option("--profile", help="Whose links, a list with commas; empty: all.")] = "",
    shaper: Annotated[str, typer.Option(help=SHAPER_HELP)] = SHAPERS[0],
    results: Annotated[Path, typer.Option(help="Folder for the results.")] = RESULTS,
) -> None:
    """Probe the links of profiles, without flying; configured beside measured. Exit code 1 where a figure is off."""
    with _errors_as_lines():
        refuse_machines(os.environ, "testbed links")
        only_run()
        if not check_profiles(profiles, shaper, fleet_of(os.environ), results.absolute(), make_console()):
            raise typer.Exit(1)


@app.command(name="fleet")
def make_fleet_files() -> None:
    """Make compose.yaml of services/fleet.yaml, and the files that AUTOPILOT and ROUTER lay over it."""
    with _errors_as_lines():
        for path, text in files_of_standard_fleet().items():
            path.write_text(text, encoding="utf-8")
            typer.echo(shown_path(path))


def _run(plan: Plan, results: Path) -> None:
    """Fly, measure and report a plan."""
    check_settings([plan])
    console = make_console()
    only_run()
    if plan.page is not None:
        console.print(f"the page: {page_url(plan.page)} (what it shows does not count)", soft_wrap=True, markup=False)
    progress = ConsoleProgress(console)
    with _machines(plan, progress) as make_containers:
        series = new_series(results.absolute(), plan.experiment, plan.label + suffix(os.environ), plan.profile.name)
        with reported_without_docker(series, console):
            endings = run_series(plan, series, progress, make_containers)
        metrics = report_series(series.path, console)
    if plan.page is not None:
        if not all(ending.was_only_watched for ending in endings):
            raise typer.Exit(1)
        return
    counted = [attempt["status"] for side in metrics["protocols"].values() for attempt in side["attempts"]]
    if counted != ["completed"] * len(endings):
        raise typer.Exit(1)


@contextlib.contextmanager
def _machines(plan: Plan, progress: ConsoleProgress) -> Iterator[Callable[..., Containers]]:
    """What makes a plan's containers; its machines are joined meanwhile, and left as they were."""
    if not plan.machines:
        yield Containers
        return
    with signals_interrupt("what was captured is kept"), contextlib.ExitStack() as stack:
        with progress.phase(f"joining {1 + len(plan.machines)} machines"):
            make_containers = stack.enter_context(containers_on(plan))
        try:
            yield make_containers
        finally:
            with signals_wait():
                stack.close()


@contextlib.contextmanager
def _errors_as_lines() -> Iterator[None]:
    """Turn an error raised on purpose into one line on stderr and its exit code."""
    try:
        yield
    except TestbedError as error:
        typer.echo(f"testbed: {error}", err=True)
        raise typer.Exit(error.exit_code) from None
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        is_typed = error.errno == errno.ENAMETOOLONG  # the testbed's own names are short
        expected = "; expected a shorter path" if is_typed else ""
        typer.echo(f"testbed: {name}{error.strerror or error}{expected}", err=True)
        raise typer.Exit(UserError.exit_code if is_typed else 1) from None


for live in (up, link, page, down):
    app.command()(_errors_as_lines()(live))
app.command()(_errors_as_lines()(packets))
app.command()(_errors_as_lines()(summary))
app.command(name="all")(_errors_as_lines()(fly_everything))
app.command()(_errors_as_lines()(reproduce))
for command in (certificate, scheduler, worker):
    app.command()(_errors_as_lines()(command))
_profiles = typer.Typer(invoke_without_command=True, callback=_errors_as_lines()(profiles.profiles))
_profiles.command()(_errors_as_lines()(profiles.show))
app.add_typer(_profiles, name="profiles")


def main() -> None:
    """Entry point of the `testbed` command."""
    sys.exit(app())
