"""The page of what was found: its tables are what the command makes of the metrics that are kept beside it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from testbed.plan.experiments import EXPERIMENTS
from testbed.present.summary.cells import Found, find_cells
from testbed.present.summary.markdown import fill
from tests.unit.docs.figures_of_findings import Findings, passages

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE, SERIES = DOCS / "results.md", DOCS / "findings" / "README.md"
pytestmark = pytest.mark.long  # some twenty metrics.json are held to their schema


@pytest.fixture(scope="module")
def found() -> Found:
    return find_cells([DOCS / "findings"])


def pattern(figures: Sequence[str]) -> re.Pattern[str]:
    """Of a line that has these figures, each whole, in this order."""
    return re.compile(".*?".join(rf"(?<![\w.,]){re.escape(figure)}(?!\w|[.,]\d)" for figure in figures))


@pytest.mark.parametrize("page", [PAGE, SERIES], ids=["results", "series"])
def test_the_tables_are_what_the_command_writes(found: Found, tmp_path: Path, page: Path) -> None:
    copy = tmp_path / "page.md"
    shutil.copyfile(page, copy)
    assert found.unread == ()
    names = fill(copy, found.cells)
    assert copy.read_text() == page.read_text()
    flown = {path.name for path in (DOCS / "findings").iterdir()}
    assert {name.split(":")[1] for name in names} == flown & set(EXPERIMENTS)


def test_the_figures_in_the_text_are_those_of_the_series_in_their_order(found: Found) -> None:
    lines = PAGE.read_text().splitlines()
    held = list(passages(Findings(found.cells)))
    assert len(held) > 15
    assert [figures for figures in held if not any(map(pattern(figures).search, lines))] == []


def test_a_figure_is_found_whole_and_in_its_place_alone() -> None:
    held = pattern(["1.2 times", "63 %"])
    assert held.search("it sends 1.2 times as many; 63 % of that is upkeep")
    assert not any(map(held.search, ("11.2 times; 63 %", "1.2 times; 163 %", "63 %; 1.2 times", "1.2 timess; 63 %")))


def test_every_series_that_is_kept_is_named_and_every_named_one_kept() -> None:
    kept = {"/".join(path.parts[-4:-1]) for path in (DOCS / "findings").glob("*/*/*/metrics.json")}
    named = set(re.findall(r"^\| `([a-z0-9-]+/[^`]+)` \|", SERIES.read_text(), re.MULTILINE))
    assert named == kept
