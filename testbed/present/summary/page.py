"""The summary as a page: a section for each experiment, with its figure, its numbers and the thesis's claims."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...fly.results import write_text
from ...numbers import words
from ...numbers.quantities import ratios as ratios_of
from ...plan import wording
from ...plan.experiments import MESSAGES
from ..report.comparison import completion
from ..report.figures.files import write_figure
from ..report.html import environment, path_of_report
from . import claims, kinds, numbers, traffic
from .cells import Cell, Found
from .figure import ratios
from .overview import overviews

PAGE = "summary.html"


def write_summary(found: Found, target: Path, experiments: Sequence[str] = ()) -> None:
    """Write a self-contained page, and next to it each figure's data (`.csv`) and the figure for papers (`.pdf`).

    Every cell links to its series' own report, relative to the page. `experiments` are shown even if they were not
    flown.
    """
    shown = overviews(found.cells, experiments)
    figures = {one.experiment: figure for one in shown if (figure := ratios(one)) is not None}
    tables = {
        (one.experiment, block.profile): traffic.table([b for cell, _ in block.judged for b in traffic.bytes_of(cell)])
        for one in shown
        for block in one.blocks
    }
    page = (
        environment()
        .get_template("summary.html")
        .render(
            finding=finding(found.cells),
            overviews=shown,
            figures=figures,
            bytes=tables,
            names={one.experiment: wording.EXPERIMENT_NAMES.get(one.experiment, one.experiment) for one in shown},
            what=wording.EXPERIMENT_WHAT,
            columns=numbers.COLUMNS,
            kinds=kinds,
            claims=[claim.heading for claim in claims.claims()],
            readings={"numbers": numbers.READING, "claims": claims.READING, "bytes": traffic.READING},
            completed=numbers.completed_of,
            machines=any(cell.machine for cell in found.cells),
            report=lambda cell: path_of_report(cell.series, target),
            beside=target.stem,
            unread=found.unread,
        )
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    write_text(target, page)
    for figure in figures.values():
        write_figure(target.with_name(f"{target.stem}-{figure.name}"), figure)


def finding(cells: Sequence[Cell]) -> str:
    """How many attempts were completed over each protocol, and the range of the ratios of bytes and times."""
    done = dict.fromkeys(wording.PROTOCOL_NAMES, (0, 0))
    for cell in cells:
        for protocol, one in completion(cell.metrics).items():
            whole, of = done[protocol]
            done[protocol] = whole + one.completed, of + one.flown
    parts = [f"{wording.name_of(p)} completed {whole:,} of {of:,} attempts" for p, (whole, of) in done.items() if of]
    said = f"In {len(cells)} series {wording.listed(parts)}"
    missions = [ratios_of(cell.sides) for cell in cells if cell.experiment != MESSAGES]
    compared = [one for one in missions if {"size", "mission"} <= set(one)]
    if not compared:
        return f"{said}; in none of them did both complete a mission."
    size, mission = (_span([one[name] for one in compared]) for name in ("size", "mission"))
    return (
        f"{said}; where both completed a mission, MAVLink needed {size} times the bytes and {mission} times the time."
    )


def _span(ratios: list[float]) -> str:
    least, most = words.ratio(min(ratios)), words.ratio(max(ratios))
    return least if least == most else f"{least} to {most}"
