"""The headline table: the cells that are flown again, and the margins in which their figures count as the same."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import UserError
from .documents import ROOT, read_document, shown
from .experiments import MOST_ATTEMPTS, Plan, make_plan
from .typed import whole_number

HEADLINE = ROOT / "testbed" / "plan" / "headline.yaml"
SCHEMA_FILE = Path(__file__).with_name("headline.schema.json")
RATIO = "ratio"
LEAST_ATTEMPTS = 3
"""The least number of pairs with which a line can be decided."""


@dataclass(frozen=True)
class HeadlineLine:
    """The expected figure of a quantity, `of` RATIO or one protocol, and the edges of its `margin`."""

    quantity: str
    of: str
    expected: float
    margin: tuple[float, float]
    reason: str


@dataclass(frozen=True)
class HeadlineCell:
    """A series to be flown, and the lines by which it is judged."""

    plan: Plan
    lines: tuple[HeadlineLine, ...]

    @property
    def name(self) -> str:
        return f"{self.plan.experiment}, arm {self.plan.label}, profile {self.plan.profile.name}"


@dataclass(frozen=True)
class Headline:
    """The whole table; the order of the protocols and the resamples are drawn from `seed`."""

    path: Path
    attempts: int
    seed: int
    cells: tuple[HeadlineCell, ...]


def read_headline(path: Path = HEADLINE, attempts: str = "", seed: str = "") -> Headline:
    """Read the table of a file; `attempts` and `seed` replace the file's unless they are empty.

    Raises UserError that names file and field, or the option, with its value and what was expected.
    """
    said = read_document(path, SCHEMA_FILE)
    how_often = whole_number("ATTEMPTS", attempts, MOST_ATTEMPTS) if attempts else int(said["attempts"])
    drawn = _seed(seed) if seed else int(said["seed"])
    cells: list[HeadlineCell] = []
    for number, cell in enumerate(said["cells"]):
        where = f"{shown(path)}: cells[{number}]"
        lines = tuple(_line(f"{where}.lines[{at}]", line) for at, line in enumerate(cell["lines"]))
        try:
            plan = make_plan(cell["experiment"], str(how_often), cell["arm"], cell["profile"])
        except UserError as error:
            raise UserError(f"{where}.profile: {cell['profile']!r}: {error}") from error
        cells.append(HeadlineCell(replace(plan, order_seed=drawn), lines))
        if len({one.name for one in cells}) < len(cells):
            raise UserError(f"{where}: {cells[-1].name!r}: expected each experiment, arm and profile once")
    return Headline(path, how_often, drawn, tuple(cells))


def _line(where: str, said: dict[str, Any]) -> HeadlineLine:
    low, high = (float(edge) for edge in said["margin"])
    if not low <= said["expected"] <= high:
        expected = f"two numbers, the lower first, with the expected figure {said['expected']:g} between them"
        raise UserError(f"{where}.margin: {said['margin']}: expected {expected}")
    return HeadlineLine(said["quantity"], said["of"], float(said["expected"]), (low, high), said["reason"])


def _seed(text: str) -> int:
    if not text.isascii() or not text.isdecimal() or len(text) > 15:
        raise UserError(f"SEED={text[:40]}: expected a whole number from 0 on, of 15 digits at most")
    return int(text)
