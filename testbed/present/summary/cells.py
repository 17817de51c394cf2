"""The series in results folders that counts for each experiment, arm and profile."""

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

    `arm` is as in the path, with the factors that deviate from the arm: thesis+qos-1.
    """

    experiment: str
    arm: str
    profile: str
    series: Series
    metrics: Metrics

    @cached_property
    def sides(self) -> Sides:
        """Its attempts, typed; both protocols, even if one was not flown."""
        observed = observe(self.metrics["protocols"])
        return {protocol: observed.get(protocol, NO_SIDE) for protocol in SIDES}

    @property
    def name(self) -> str:
        """Its path in the results folder: scenario-1/thesis-ideal/20260101T000000Z."""
        return "/".join(self.series.path.parts[-3:])

    @property
    def machine(self) -> str:
        """The machine that flew it; empty if unknown, or if there were several."""
        return self.metrics.get("machine") or ""

    def rank(self, attempts: int) -> tuple[int, int]:
        """How many protocols have an attempt that counts, and how many numbers up to `attempts` they have altogether.

        A number that is void each time was flown all the same.
        """
        sides = self.metrics["protocols"].values()
        numbers = [{one["attempt"] for one in (*side["attempts"], *side["void"])} for side in sides]
        flown = sum(len(one & set(range(1, attempts + 1))) for one in numbers)
        return sum(bool(side["attempts"]) for side in sides), flown


@dataclass(frozen=True)
class Found:
    """The cells, and a line for each newer series that could not be read."""

    cells: tuple[Cell, ...]
    unread: tuple[str, ...] = ()


def find_cells(roots: Sequence[Path], attempts: int = 0) -> Found:
    """Find the newest finished series of each cell, preferably one in which both protocols have an attempt that counts.

    Among these one with all numbers up to `attempts` is preferred to a newer one that was broken off.
    A series is finished once it is measured. Raises UserError if a root is no folder.
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
            if chosen is None or cell.rank(attempts) > chosen.rank(attempts):
                chosen = cell
            if chosen.rank(attempts) == (len(SIDES), len(SIDES) * attempts):
                break
        if chosen is not None:
            cells.append(chosen)
    return Found(tuple(cells), tuple(unread))


def _cell(experiment: str, label: str, series: Series) -> Cell:
    metrics = read_metrics(series)
    arm = label.removesuffix(f"-{metrics['profile']}")
    return Cell(experiment, arm, metrics["profile"], series, metrics)
