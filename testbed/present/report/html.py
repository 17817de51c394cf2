"""The page: one self-contained HTML file, with its figures' data next to it; the same bytes for the same results."""

from __future__ import annotations

import os
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import jinja2

from ...fly.results import REPORT, Series, write_text
from ...numbers import words
from ...numbers.quantities import OF_ATTEMPT
from ...numbers.written import Metrics
from ...plan import wording
from . import (
    attempt_page,
    comparison,
    details,
    factors,
    gallery,
    message_gallery,
    message_sentences,
    message_set,
    readings,
    sentences,
    thesis,
    thesis_rows,
)
from .figures.files import FOLDER, write_files

TEMPLATES = Path(__file__).parent / "page"
MOST_ROWS = 150
"""The most rows of a figure's data on the page itself; longer data are in the CSV file only."""


def write_report(series: Series, metrics: Metrics, papers: bool = False) -> Path:
    """Write `report.html` and `figures/*.csv` into the series' folder, with `papers` also a PDF of each figure.

    Returns the page's path.
    """
    flown: Counter[tuple[str, int]] = Counter()
    attempts = []
    for attempt in series.attempts():
        name = attempt.protocol, attempt.number
        if attempt.is_readable:
            attempts.append(attempt_page.page_of(series, attempt, metrics, flown[name]))
        flown[name] += 1
    order = [protocol for protocol, _ in words.sides(metrics)]
    attempts.sort(key=lambda one: (order.index(one["protocol"]), one["number"]))
    shown = comparison.shown(metrics)
    of = {p: next(a for a in attempts if a["protocol"] == p and a["measured"] is shown[p]) for p in shown}
    seen = {p: attempt_page.seen_of(of[p]) for p in shown}
    shown = {p: attempt_page.with_losses(of[p]["attempt"], one) for p, one in shown.items()}
    commands = list(dict.fromkeys(command for attempt in of.values() for command in attempt["commands"]))
    ten_kinds = message_set.is_message_set(metrics)
    if ten_kinds:
        figures = message_gallery.figures_of(metrics, shown, seen, _links(series))
    else:
        figures = gallery.figures_of(metrics, shown, seen, _links(series), commands)
    page = (
        environment()
        .get_template("messages.html" if ten_kinds else "report.html")
        .render(
            metrics=metrics,
            title=wording.EXPERIMENT_NAMES.get(metrics["experiment"], metrics["experiment"]),
            what=wording.EXPERIMENT_WHAT.get(metrics["experiment"], ""),
            flown=attempt_page.flown_at(attempts),
            finding=sentences.finding(metrics),
            basis=sentences.basis(metrics),
            troubles=[attempt for attempt in attempts if attempt["trouble"]],
            remarks=[attempt for attempt in attempts if attempt["measured"] and attempt["measured"]["notes"]],
            **_conditions(metrics, attempts),
            protocols=[protocol for protocol, _ in words.sides(metrics)],
            completion=comparison.completion(metrics),
            rows=(rows := list(comparison.rows(metrics).values())),
            tested=any(row.test for row in rows),
            thesis=thesis_rows.rows(metrics),
            caveats=thesis.caveats(metrics["experiment"]),
            attempts=attempts,
            of_attempt=OF_ATTEMPT,
            figures=figures,
            papers=papers,
            lost_none=sentences.none_lost(gallery.losses_of(shown, seen)),
            **(_kinds(metrics, attempts) if ten_kinds else {}),
            **_in_detail(shown, of, commands),
            sensors=_sensors(metrics, shown),
        )
    )
    write_files(series.path / FOLDER, figures, papers)
    target = series.path / REPORT
    write_text(target, page)
    return target


@cache
def environment() -> jinja2.Environment:
    """The templates, each compiled once, with the filters and limits that all pages share."""
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    names = ("size", "seconds", "milliseconds", "thousands", "digits", "ratio", "percent", "share")
    made.filters |= {name: getattr(words, name) for name in (*names, "bit_rate", "short_delay")}
    made.filters["name_of"] = wording.name_of
    made.filters["tied"] = lambda text: text.replace("(< ", "(<\xa0").replace(" %", "\xa0%")
    made.filters["at"] = lambda percent: f"{percent:.2f}%"
    made.tests["in_folder"] = lambda path, folder: path.startswith(f"{folder}/")
    made.globals |= {"most_rows": MOST_ROWS, "folder": FOLDER}
    return made


def path_of_report(series: Series, page: Path) -> str | None:
    """The path of a series' own report relative to another page; None if it has none."""
    report = series.path / REPORT
    return Path(os.path.relpath(report, page.parent.resolve())).as_posix() if report.exists() else None


def _links(series: Series) -> list[tuple[str, str, str]]:
    topology = series.readable()[0].topology()
    return [(link.name, link.lower, link.upper) for link in topology.links]


def _conditions(metrics: Metrics, attempts: list[dict[str, Any]]) -> dict[str, Any]:
    """How the series was flown: its factors in words, and whether all attempts were flown alike."""
    configuration: dict[str, Any] = {}
    for attempt in attempts:
        configuration = {**attempt["manifest"]["configuration"], **configuration}
    both, one_drone = len(metrics["protocols"]) > 1, message_set.is_message_set(metrics)
    return {
        "factors": {p: factors.factors_of(configuration, p, one_drone) for p, _ in words.sides(metrics)},
        "fairness": factors.fairness(configuration, one_drone) if both else [],
        "deviations": factors.deviations(configuration, metrics["arm"]),
        "mixed": factors.mixed([attempt["manifest"] for attempt in attempts]),
    }


def _sensors(metrics: Metrics, shown: details.Shown) -> dict[str, Any]:
    """The section on sensors; its rows are empty without sensors."""
    return {
        "rows": readings.rows_of(shown),
        "said": readings.said(metrics),
        "traffic": readings.traffic_of(shown),
        "purposes": [name for _, name in readings.PURPOSES],
        "cost": readings.cost(shown),
    }


def _kinds(metrics: Metrics, attempts: list[dict[str, Any]]) -> dict[str, Any]:
    """The parts that only the message set's page has."""
    table = message_set.rows(metrics)
    states = {str(attempt["manifest"]["configuration"].get("states")) for attempt in attempts}
    return {
        "message_set": True,
        "kinds": table,
        "kind_totals": message_set.totals(metrics),
        "shortfalls": message_sentences.shortfalls(metrics),
        "bundled": "bundle" in states,
    }


def _in_detail(shown: details.Shown, of: dict[str, dict[str, Any]], commands: list[str]) -> dict[str, Any]:
    """The detailed tables of one attempt per protocol."""
    grids = {p: details.outcomes_of(shown[p], commands) for p in shown}
    drones = sorted({drone for grid in grids.values() for drone in grid}, key=lambda drone: (len(drone), drone))
    roles = details.roles_of({p: cpu for p in shown if (cpu := shown[p]["cpu_s"])})
    most_bytes = {p: found for p in shown if (found := shown[p]["memory_bytes"])}
    routers = details.routers_of(shown["mavlink"]) if "mavlink" in shown else []
    return {
        "shown": of,
        "links": details.links_of(shown),
        "measured_links": details.measured_links(shown),
        "commands": commands,
        "by_command": {
            p: {name: details.command_of(shown[p], of[p]["events"], name) for name in commands} for p in shown
        },
        "grid": [(drone, {p: grids[p].get(drone, [None] * len(commands)) for p in shown}) for drone in drones],
        "sizes": details.sizes_of(shown),
        "states": details.states_of(shown),
        "mix": details.mix_of(shown["mavlink"]) if "mavlink" in shown else None,
        "routers": routers,
        "copies": any(r["out"] > r["in"] for _, ways in routers for r in ways.values()),
        "roles": roles,
        "memory": {role.name: role.sums for role in details.roles_of(most_bytes)},
        "own_cpu": details.protocols_own(roles),
        "most_cpu": max((seconds for role in roles for seconds in role.sums.values()), default=0.0),
    }
