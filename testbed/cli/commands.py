"""The `testbed` command."""

from __future__ import annotations

import contextlib
import functools
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from net.link_plan import SHAPERS

from ..errors import TestbedError, UserError
from ..fly.containers import Containers, only_run
from ..fly.flights import by_hand, settings_of
from ..fly.link_check import check_profiles
from ..fly.links import plan_links, start_clock, write_plan
from ..fly.live_links import changes, read_live_plan, tell
from ..fly.progress import ConsoleProgress
from ..fly.results import live_attempt, new_series, open_series
from ..fly.runner import run_series
from ..numbers.metrics import measure_series, read_metrics, verdict
from ..plan.experiments import (
    ARMS,
    DEFAULT_COUNT,
    DEFAULT_SAMPLES,
    EXPERIMENTS,
    FACTORS,
    PROTOCOLS,
    Plan,
    make_plan,
    one_protocol,
)
from ..plan.fleets import fleet_of, standard_fleet
from ..plan.overrides import files_of_standard_fleet, fleet_in, suffix
from ..present.report.compare import result_of
from ..present.report.compare_page import print_comparison, write_comparison
from ..present.reporting import RESULTS, make_console, report_series, reported_without_docker, shown_path
from . import profiles as profiles
from .campaign import fly_everything
from .packets import packets
from .summary import summary

LIVE = RESULTS / ".live"


PROFILE_HELP = "How the links are: a name of `testbed profiles`, or the path of a .yaml file."
SHAPER_HELP = f"What shapes the links: {', '.join(SHAPERS)}; auto: netem where the kernel has it."


def _factor_help(name: str) -> str:
    return f"{', '.join(FACTORS[name])}; empty: the arm's."


app = typer.Typer(
    name="testbed",
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
    streams: Annotated[str, typer.Option(help=_factor_help("streams"))] = "",
    commanding: Annotated[str, typer.Option(help=_factor_help("commanding"))] = "",
    qos: Annotated[str, typer.Option(help=_factor_help("qos"))] = "",
    chain: Annotated[str, typer.Option(help=_factor_help("chain"))] = "",
    states: Annotated[str, typer.Option(help=_factor_help("states"))] = "",
    samples: Annotated[str, typer.Option(help="Scenario 4: values of each series.")] = str(DEFAULT_SAMPLES),
    count: Annotated[str, typer.Option(help="messages: how many of each kind.")] = str(DEFAULT_COUNT),
    results: Annotated[Path, typer.Option(help="Folder for the results.")] = RESULTS,
) -> None:
    """Fly an experiment, measure it, and write its report. Exit code 0 only if every attempt was completed."""
    with _errors_as_lines():
        factors = {"streams": streams, "commanding": commanding, "qos": qos, "chain": chain, "states": states}
        plan = make_plan(
            experiment, attempts, arm, profile, protocols, factors, shaper, samples, count, fleet_of(os.environ)
        )
        _run(plan, results)


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
        _run(make_plan(mission, attempts, arm, profile, protocols, fleet=fleet_of(os.environ)), results)


@app.command()
def report(
    results: Annotated[list[Path], typer.Argument(help="Folders of series, as results/scenario-1/latest.")],
) -> None:
    """Make metrics and report again, from the results folder alone."""
    with _errors_as_lines():
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
    table = Table("", *ARMS, "can be", box=None, pad_edge=False, header_style="bold")
    for name, values in FACTORS.items():
        own = [str(getattr(arm.factors, name)) for arm in ARMS.values()]
        table.add_row(name.upper(), *own, ", ".join(values))
    make_console().print(table)


@app.command()
def up(
    protocol: Annotated[str, typer.Option(help=f"Over what: {' or '.join(PROTOCOLS)}.")] = PROTOCOLS[0],
    arm: Annotated[str, typer.Option(help=f"How the fleet talks: {', '.join(ARMS)}.")] = "thesis",
    streams: Annotated[str, typer.Option(help=_factor_help("streams"))] = "",
    qos: Annotated[str, typer.Option(help=_factor_help("qos"))] = "",
    chain: Annotated[str, typer.Option(help=_factor_help("chain"))] = "",
    states: Annotated[str, typer.Option(help=_factor_help("states"))] = "",
    commanding: Annotated[str, typer.Option(help=_factor_help("commanding"))] = "",
    encoding: Annotated[str, typer.Option(help="Payloads of fogs and drones: cbor, or json for people.")] = "cbor",
    profile: Annotated[str, typer.Option(help=PROFILE_HELP)] = "ideal",
    shaper: Annotated[str, typer.Option(help=SHAPER_HELP)] = SHAPERS[0],
) -> None:
    """Start the fleet and leave it running, to explore by hand."""
    with _errors_as_lines():
        factors = {"streams": streams, "commanding": commanding, "qos": qos, "chain": chain, "states": states}
        fleet = fleet_of(os.environ)
        plan = make_plan("scenario-1", "1", arm, profile, one_protocol(protocol), factors, shaper, fleet=fleet)
        settings = settings_of(plan, protocol, encoding)
        only_run()
        attempt = live_attempt(LIVE, protocol)
        write_plan(attempt.path / "links", plan_links(plan, 1), plan.topology, plan.shaper, always=True)
        containers = Containers(protocol, LIVE, settings, fleet)
        with ConsoleProgress(make_console()).phase(f"starting {containers.count} containers"):
            containers.down()
            containers.start()
        start_clock(attempt.path / "links")
        typer.echo(by_hand(plan, protocol, containers.name_of))


@app.command()
def link(
    name: Annotated[str, typer.Argument(help="The link, as air:uav3; air:uav3:up for one direction of it.")],
    rate: Annotated[str, typer.Option(help="Bits a second, as 1Mbit, or unlimited.")] = "",
    queue: Annotated[str, typer.Option(help="Frames that wait for the rate, as '100 packets'.")] = "",
    delay: Annotated[str, typer.Option(help="As 200ms.")] = "",
    jitter: Annotated[str, typer.Option(help="As 20ms.")] = "",
    loss: Annotated[str, typer.Option(help="As 20%.")] = "",
    duplicate: Annotated[str, typer.Option(help="As 1%.")] = "",
    corrupt: Annotated[str, typer.Option(help="As 1%.")] = "",
    reorder: Annotated[str, typer.Option(help="As 1%.")] = "",
    closed: Annotated[bool, typer.Option("--closed", help="Let nothing through.")] = False,
    back: Annotated[bool, typer.Option("--back", help="As its profile says again.")] = False,
) -> None:
    """Change a link of the fleet that is up; what is not named is as its profile says."""
    with _errors_as_lines():
        given = {
            **{"rate": rate, "queue": queue, "delay": delay, "jitter": jitter, "loss": loss},
            **{"duplicate": duplicate, "corrupt": corrupt, "reorder": reorder},
        }
        typed = {option: value for option, value in given.items() if value}
        fleet = fleet_in(LIVE)
        containers = Containers(PROTOCOLS[0], LIVE, {}, fleet)
        ask = functools.partial(containers.output, "net", user="0:0")
        for change in changes(read_live_plan(ask), fleet.topology(), name, typed, closed=closed, back=back):
            tell(ask, change)
            said = [f"{option} {value}" for option, value in typed.items()] + (["closed"] if closed else [])
            typer.echo(f"{change.link}: {', '.join(said) or 'as planned'}")


@app.command()
def links(
    profiles: Annotated[str, typer.Option("--profile", help="Whose links, a list with commas; empty: all.")] = "",
    shaper: Annotated[str, typer.Option(help=SHAPER_HELP)] = SHAPERS[0],
    results: Annotated[Path, typer.Option(help="Folder for the results.")] = RESULTS,
) -> None:
    """Probe the links of profiles, without flying; configured beside measured. Exit code 1 where a figure is off."""
    with _errors_as_lines():
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


@app.command()
def down() -> None:
    """End what `up` started, over whatever protocol and with whatever fleet."""
    with _errors_as_lines(), ConsoleProgress(make_console()).phase("ending the containers"):
        Containers(PROTOCOLS[0], LIVE, {}, standard_fleet()).down()


def _run(plan: Plan, results: Path) -> None:
    """Fly, measure and report a plan."""
    for protocol in plan.protocols:
        settings_of(plan, protocol)  # its errors are raised before anything is written
    console = make_console()
    only_run()
    series = new_series(results.absolute(), plan.experiment, plan.label + suffix(os.environ), plan.profile.name)
    with reported_without_docker(series, console):
        endings = run_series(plan, series, ConsoleProgress(console))
    metrics = report_series(series.path, console)
    counted = [attempt["status"] for side in metrics["protocols"].values() for attempt in side["attempts"]]
    if counted != ["completed"] * len(endings):
        raise typer.Exit(1)


@contextlib.contextmanager
def _errors_as_lines() -> Iterator[None]:
    """An error raised on purpose becomes one line on stderr and its exit code."""
    try:
        yield
    except TestbedError as error:
        typer.echo(f"testbed: {error}", err=True)
        raise typer.Exit(error.exit_code) from None
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        typer.echo(f"testbed: {name}{error.strerror or error}", err=True)
        raise typer.Exit(1) from None


app.command()(_errors_as_lines()(packets))
app.command()(_errors_as_lines()(summary))
app.command(name="all")(_errors_as_lines()(fly_everything))
_profiles = typer.Typer(invoke_without_command=True, callback=_errors_as_lines()(profiles.profiles))
_profiles.command()(_errors_as_lines()(profiles.show))
app.add_typer(_profiles, name="profiles")


def main() -> None:
    """Entry point of the `testbed` command."""
    sys.exit(app())
