"""Which series counts for each experiment, arm and profile, of results folders."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ...errors import ResultsError, UserError
from ...fly.results import METRICS, Series
from ...numbers.metrics import read_metrics
from ...numbers.observed import NO_SIDE, Sides, observe
from ...numbers.written import Metrics

SIDES = ("mqttxt", "mavlink")


@dataclass(frozen=True)
class Cell:
    """The series that counts for an experiment in an arm on a profile, and its metrics.

    `arm` is as the path has it, with what deviates from the arm: thesis+qos-1.
    """

    experiment: str
    arm: str
    profile: str
    series: Series
    metrics: Metrics

    @cached_property
    def sides(self) -> Sides:
        """Its attempts, typed; both protocols, though one was not flown."""
        observed = observe(self.metrics["protocols"])
        return {protocol: observed.get(protocol, NO_SIDE) for protocol in SIDES}

    @property
    def name(self) -> str:
        """As the results folder has it: scenario-1/thesis-ideal/20260101T000000Z."""
        return "/".join(self.series.path.parts[-3:])

    @property
    def machine(self) -> str:
        """The machine that flew it; nothing where that is not known, or is not one."""
        return self.metrics.get("machine") or ""

    @property
    def both(self) -> bool:
        """Whether an attempt of each protocol counts."""
        return _sides_of(self.metrics) == len(SIDES)


@dataclass(frozen=True)
class Found:
    """The cells, and a line for each newer series that could not be read."""

    cells: tuple[Cell, ...]
    unread: tuple[str, ...] = ()


def find_cells(roots: Sequence[Path]) -> Found:
    """The newest finished series of each cell: first of those in which both protocols have an attempt that counts.

    A series is finished when it has been measured. Raises UserError for a folder that is none.
    """
    by_cell: dict[tuple[str, str], list[Series]] = defaultdict(list)
    for root in roots:
        if not root.is_dir():
            raise UserError(f"{root}: expected a results folder, with <experiment>/<arm>-<profile>/<time> in it")
        for path in root.resolve().glob(f"*/*/*/{METRICS}"):
            series = Series(path.parent)
            by_cell[(path.parts[-4], path.parts[-3])].append(series)
    cells, unread = [], []
    for (experiment, label), several in sorted(by_cell.items()):
        chosen: Cell | None = None
        for series in sorted(several, key=lambda one: one.path.name, reverse=True):
            try:
                cell = _cell(experiment, label, series)
            except ResultsError as error:
                unread.append(str(error))
                continue
            if chosen is None or _sides_of(cell.metrics) > _sides_of(chosen.metrics):
                chosen = cell
            if chosen.both:
                break
        if chosen is not None:
            cells.append(chosen)
    return Found(tuple(cells), tuple(unread))


def _cell(experiment: str, label: str, series: Series) -> Cell:
    metrics = read_metrics(series)
    arm = label.removesuffix(f"-{metrics['profile']}")
    return Cell(experiment, arm, metrics["profile"], series, metrics)


def _sides_of(metrics: Metrics) -> int:
    """How many protocols have an attempt that counts."""
    return sum(bool(side["attempts"]) for side in metrics["protocols"].values())
