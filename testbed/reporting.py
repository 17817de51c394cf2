"""What follows a flight: its series is measured, its report written, and its summary shown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console

from .metrics import measure_series
from .report.html import write_report
from .report.terminal import print_summary
from .results import open_series


def report_series(path: Path, console: Console) -> dict[str, Any]:
    """Metrics, page and figures of a series from its folder alone, and its summary on the terminal.

    Returns the metrics. Raises ResultsError.
    """
    series = open_series(path)
    metrics = measure_series(series)
    target = write_report(series, metrics, papers=True)
    print_summary(series, metrics, console)
    console.print(f"report: {shown_path(target)}", soft_wrap=True, markup=False)
    return metrics


def shown_path(target: Path) -> str:
    """The path of a report as people type it, by `latest` where that is this series."""
    latest = target.parent.parent.parent / "latest"
    if latest.exists() and latest.resolve() == target.parent:
        target = latest / target.name
    return str(target.relative_to(Path.cwd()) if target.is_relative_to(Path.cwd()) else target)
