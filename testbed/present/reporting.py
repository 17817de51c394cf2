"""The steps after a flight: measure its series, write its report, and print its summary."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console

from ..errors import DockerError
from ..fly.results import Series, open_series
from ..numbers.metrics import measure_series
from ..numbers.written import Metrics
from ..plan.documents import ROOT
from .report.html import write_report
from .report.terminal import print_summary

RESULTS = ROOT / "results"


def make_console() -> Console:
    """The terminal; for a file or a pipe, wide enough for the tables."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=120)


@contextlib.contextmanager
def reported_without_docker(series: Series, console: Console) -> Iterator[None]:
    """Report the flown part of a series if Docker no longer answers, and raise the DockerError again."""
    try:
        yield
    except DockerError:
        if any(attempt.was_flown for attempt in series.attempts()):
            report_series(series.path, console)
        raise


def report_series(path: Path, console: Console) -> Metrics:
    """Make metrics, page and figures of a series from its folder alone, and print its summary.

    Returns the metrics. Raises UserError if the path is no series, ResultsError if it cannot be read.
    """
    series = open_series(path)
    metrics = measure_series(series)
    target = write_report(series, metrics, papers=True)
    print_summary(series, metrics, console)
    console.print(f"report: {shown_path(target)}", soft_wrap=True, markup=False)
    return metrics


def shown_path(target: Path) -> str:
    """The path of a report as one would type it, with `latest` if that is this series."""
    latest = target.parent.parent.parent / "latest"
    if latest.exists() and latest.resolve() == target.parent:
        target = latest / target.name
    return str(target.relative_to(Path.cwd()) if target.is_relative_to(Path.cwd()) else target)
