"""The page: one self-contained HTML file, the same bytes for the same results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2

from ..metrics import mission_window
from ..results import REPORT, Attempt, Series
from . import words
from .figures import flights_of, layer_bar, timeline
from .terminal import link_pairs

TEMPLATES = Path(__file__).parent


def write_report(series: Series, metrics: dict[str, Any]) -> Path:
    """Write `report.html` into the series folder; returns its path."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {
        "size": words.size,
        "seconds": words.seconds,
        "milliseconds": words.milliseconds,
        "thousands": lambda value: f"{value:,}",
    }
    attempts = [_attempt(series, attempt, metrics) for attempt in series.attempts()]
    page = environment.get_template("report.html").render(
        metrics=metrics,
        title=words.EXPERIMENT_NAMES.get(metrics["experiment"], metrics["experiment"]),
        what=words.EXPERIMENT_WHAT.get(metrics["experiment"], ""),
        finding=words.finding(metrics),
        notes=words.notes(metrics),
        revisions=_revisions(attempts),
        names=words.PROTOCOL_NAMES,
        loss=words.loss,
        attempts=attempts,
        series=series.path.name,
    )
    target = series.path / REPORT
    target.write_text(page, encoding="utf-8")
    return target


def _attempt(series: Series, attempt: Attempt, metrics: dict[str, Any]) -> dict[str, Any]:
    """What the page shows of one attempt; `measured` is None for a void one."""
    manifest = attempt.manifest()
    side = metrics["protocols"][attempt.protocol]
    measured = next((entry for entry in side["attempts"] if entry["attempt"] == attempt.number), None)
    folder = attempt.path.relative_to(series.path).as_posix()
    events = attempt.events()
    window = mission_window(attempt, events)
    flights = flights_of(attempt.autopilot_events(), events, window.start_ns) if window is not None else []
    commands = list(dict.fromkeys(event["command"] for event in events if event["event"] == "command"))
    return {
        "number": attempt.number,
        "protocol": attempt.protocol,
        "name": words.PROTOCOL_NAMES.get(attempt.protocol, attempt.protocol),
        "manifest": manifest,
        "measured": measured,
        "folder": folder,
        "files": [path.relative_to(series.path).as_posix() for path in _files(attempt)],
        "timeline": timeline(flights, window.seconds) if window is not None and flights else None,
        "layers": layer_bar(measured["layers"]) if measured is not None and measured["layers"] else None,
        "links": link_pairs(measured) if measured is not None else [],
        "commands": commands,
        "grid": _grid(measured, commands) if measured is not None else [],
        "dropped": sum(capture["dropped"] or 0 for capture in manifest.get("captures", [])),
        "captured": sum(capture["captured"] or 0 for capture in manifest.get("captures", [])),
    }


def _revisions(attempts: list[dict[str, Any]]) -> int:
    """At how many revisions the attempts were flown."""
    return len({str(attempt["manifest"]["revision"].get("commit")) for attempt in attempts})


def _files(attempt: Attempt) -> list[Path]:
    patterns = ("manifest.json", "events.jsonl", "pcap/*.pcap", "sitl/*.jsonl", "logs/*.log")
    return [path for pattern in patterns for path in sorted(attempt.path.glob(pattern))]


def _grid(measured: dict[str, Any], commands: list[str]) -> list[dict[str, Any]]:
    """For each drone its outcome of every command, in the order in which they were sent."""
    rows = []
    for drone, entries in measured["outcomes"].items():
        by_command = {entry["command"]: entry for entry in entries}
        rows.append({"drone": drone, "cells": [by_command.get(command) for command in commands]})
    return rows
