"""The `testbed` command."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from .containers import Containers, only_run
from .errors import TestbedError
from .experiments import make_plan
from .metrics import measure_series
from .progress import ConsoleProgress
from .report.html import write_report
from .report.terminal import print_summary
from .results import open_series
from .runner import CLOUD_URL, run_series, settings_of
from .topology import ROOT

RESULTS = ROOT / "results"
LIVE = RESULTS / ".live"

app = typer.Typer(
    name="testbed",
    help="Flies the same mission over MQTT-XT and MAVLink on the same links, and shows what went over them.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.command()
def run(
    experiment: Annotated[str, typer.Argument(help="What to fly: scenario-1.")],
    attempts: Annotated[str, typer.Option(help="How often.")] = "1",
    arm: Annotated[str, typer.Option(help="How the fleet talks: thesis.")] = "thesis",
    profile: Annotated[str, typer.Option(help="How the links are: ideal.")] = "ideal",
    protocols: Annotated[str, typer.Option(help="Over what, a list: mqttxt.")] = "mqttxt",
    results: Annotated[Path, typer.Option(help="Folder for the results.")] = RESULTS,
) -> None:
    """Fly an experiment, measure it, and write its report. Exit code 0 only if every attempt was completed."""
    with _errors_as_lines():
        plan = make_plan(experiment, attempts, arm, profile, protocols)
        console = _console()
        only_run()
        series, endings = run_series(plan, results.absolute(), ConsoleProgress(console))
        metrics = _report(series.path, console)
        counted = [attempt["status"] for side in metrics["protocols"].values() for attempt in side["attempts"]]
        if counted != ["completed"] * len(endings):
            raise typer.Exit(1)


@app.command()
def report(
    results: Annotated[list[Path], typer.Argument(help="Folders of series, as results/scenario-1/latest.")],
) -> None:
    """Make metrics and report again, from the results folder alone."""
    with _errors_as_lines():
        for path in results:
            _report(path, _console())


@app.command()
def up(
    encoding: Annotated[str, typer.Option(help="Payloads of fogs and drones: cbor, or json for people.")] = "cbor",
) -> None:
    """Start the fleet and leave it running, to explore by hand."""
    with _errors_as_lines():
        for folder in (LIVE, LIVE / "pcap", LIVE / "sitl"):
            folder.mkdir(parents=True, exist_ok=True)
            folder.chmod(0o777)
        settings = settings_of(make_plan("scenario-1", "1", "thesis", "ideal", "mqttxt"), encoding)
        only_run()
        with ConsoleProgress(_console()).phase("starting 17 containers"):
            Containers("mqttxt", LIVE, settings).up()
        typer.echo(f"""\
Six drones are up. To look and to fly:
  docker exec -it mqttxt-testbed_gs_1 mqttxt gs watch --fog 1 --fog 2
  docker exec -it mqttxt-testbed_gs_1 mqttxt gs send arm --fog 1 --drone 2
  docker exec -it mqttxt-testbed_gs_1 mqttxt gs send takeoff 10 --fog 1 --drone 2
  docker exec -it mqttxt-testbed_gs_1 mosquitto_sub -h {CLOUD_URL.split("//")[1].split(":")[0]} -v -t 'fog1/#'
  make down""")


@app.command()
def down() -> None:
    """End what `up` started."""
    with _errors_as_lines(), ConsoleProgress(_console()).phase("ending the containers"):
        Containers("mqttxt", LIVE, {}).down()


def _console() -> Console:
    """The terminal; a file or a pipe is given room for the tables."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=120)


def _report(path: Path, console: Console) -> dict[str, Any]:
    series = open_series(path)
    metrics = measure_series(series)
    target = write_report(series, metrics)
    print_summary(series, metrics, console)
    console.print(f"report: {_shown(target)}", soft_wrap=True, markup=False)
    return metrics


def _shown(target: Path) -> str:
    """The path of a report as people type it, by `latest` where that is this series."""
    latest = target.parent.parent.parent / "latest"
    if latest.exists() and latest.resolve() == target.parent:
        target = latest / target.name
    return str(target.relative_to(Path.cwd()) if target.is_relative_to(Path.cwd()) else target)


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


def main() -> None:
    """Entry point of the `testbed` command."""
    sys.exit(app())
