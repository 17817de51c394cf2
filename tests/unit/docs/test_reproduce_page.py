"""The page about reproducing: its tables are what `make reproduce` found, by the margins that it was judged by."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from testbed.numbers.reproduction import JUDGED, JudgedLine
from testbed.plan.headline import HeadlineLine, read_headline
from testbed.present.reproduction import figure_of, name_of

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE, FOUND = DOCS / "reproduce.md", DOCS / "findings" / "reproduction.json"


def _row(line: HeadlineLine, found: dict[str, Any]) -> str:
    judged = JudgedLine(line, JUDGED[line.quantity], {}, (), None)
    assert (found["quantity"], found["of"]) == (line.quantity, line.of)
    published, low, high = (figure_of(judged, value) for value in (found["expected"], *found["margin"]))
    between = "–"
    if found["interval"] is not None:
        between = " to ".join(figure_of(judged, value) for value in found["interval"])
    shown = "–" if found["found"] is None else figure_of(judged, found["found"])
    cells = (name_of(judged), published, f"{low} to {high}", shown, between, str(len(found["points"])))
    return f"| {' | '.join((*cells, found['verdict']))} |"


def test_the_tables_are_what_is_flown_and_what_was_found() -> None:
    report = json.loads(FOUND.read_text(encoding="utf-8"))
    expected = []
    for cell, found in zip(read_headline().cells, report["cells"], strict=True):
        head = "| line | published | margin | found | 95 % interval | of | verdict |"
        expected += [f"**{cell.name}**, at {found['revision'][:7]}", "", head, "|---|---|---|---|---|---|---|"]
        expected += [*map(_row, cell.lines, found["lines"]), ""]
    text = PAGE.read_text(encoding="utf-8")
    shown = text.split("reproduction.json -->\n", 1)[1].split("<!-- /found -->", 1)[0]
    assert shown.strip() == "\n".join(expected).strip()
    assert f"The verdict was `{report['verdict']}`" in text
