"""The page of what was found: its tables are what the command makes of the metrics that are kept beside it."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from testbed.plan.experiments import EXPERIMENTS
from testbed.present.summary.cells import Found, find_cells
from testbed.present.summary.markdown import fill
from tests.unit.docs.what_was_said import Findings, said

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE = DOCS / "results.md"
pytestmark = pytest.mark.long  # some twenty metrics.json are held to their schema


@pytest.fixture(scope="module")
def found() -> Found:
    return find_cells([DOCS / "findings"])


def test_the_tables_are_what_the_command_writes(found: Found, tmp_path: Path) -> None:
    copy = tmp_path / "results.md"
    shutil.copyfile(PAGE, copy)
    assert found.unread == ()
    names = fill(copy, found.cells)
    assert copy.read_text() == PAGE.read_text()
    flown = {path.name for path in (DOCS / "findings").iterdir()}
    assert {name.split(":")[1] for name in names} == flown & set(EXPERIMENTS)


def test_the_figures_in_the_text_are_those_of_the_series(found: Found) -> None:
    text = PAGE.read_text()
    assert [clause for clause in said(Findings(found.cells)) if clause not in text] == []


def test_every_series_that_is_kept_is_named_and_every_named_one_kept() -> None:
    kept = {"/".join(path.parts[-4:-1]) for path in (DOCS / "findings").glob("*/*/*/metrics.json")}
    named = set(re.findall(r"^\| `([a-z0-9-]+/[^`]+)` \|", PAGE.read_text(), re.MULTILINE))
    assert named == kept
