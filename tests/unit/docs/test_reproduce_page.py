"""The page about reproducing: its tables are `testbed/plan/headline.yaml` and what `make reproduce` found."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from testbed.numbers.reproduction import JUDGED, Judged
from testbed.plan.headline import Line, read_headline
from testbed.present.reproduction import figure_of, name_of

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE, FOUND = DOCS / "reproduce.md", DOCS / "findings" / "reproduction.json"


def _row(line: Line) -> str:
    judged = Judged(line, JUDGED[line.quantity], {}, (), None)
    published, low, high = (figure_of(judged, value) for value in (line.expected, *line.margin))
    return f"| {name_of(judged)} | {published} | {low} to {high} | {line.reason} |"


def test_its_table_is_the_one_that_is_flown() -> None:
    expected = []
    for cell in read_headline().cells:
        expected += [f"**{cell.name}**", "", "| line | published | margin | why this margin |", "|---|---|---|---|"]
        expected += [*map(_row, cell.lines), ""]
    shown = PAGE.read_text(encoding="utf-8").split("headline.yaml -->\n", 1)[1].split("<!-- /headline -->", 1)[0]
    assert shown.strip() == "\n".join(expected).strip()


def _found_row(line: Line, found: dict[str, Any]) -> str:
    judged = Judged(line, JUDGED[line.quantity], {}, (), None)
    assert (found["quantity"], found["of"]) == (line.quantity, line.of)
    between = "–"
    if found["interval"] is not None:
        between = " to ".join(figure_of(judged, value) for value in found["interval"])
    shown = "–" if found["found"] is None else figure_of(judged, found["found"])
    return f"| {name_of(judged)} | {shown} | {between} | {len(found['points'])} | {found['verdict']} |"


def test_what_was_found_is_what_the_command_wrote() -> None:
    report = json.loads(FOUND.read_text(encoding="utf-8"))
    expected = []
    for cell, found in zip(read_headline().cells, report["cells"], strict=True):
        head = "| line | found | 95 % interval | of | verdict |"
        expected += [f"**{cell.name}**, at {found['revision'][:7]}", "", head, "|---|---|---|---|---|"]
        expected += [*map(_found_row, cell.lines, found["lines"]), ""]
    text = PAGE.read_text(encoding="utf-8")
    shown = text.split("reproduction.json -->\n", 1)[1].split("<!-- /found -->", 1)[0]
    assert shown.strip() == "\n".join(expected).strip()
    assert f"The verdict was `{report['verdict']}`" in text
