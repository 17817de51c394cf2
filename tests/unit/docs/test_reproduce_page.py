"""The page about reproducing: its table is that of `testbed/plan/headline.yaml`."""

from __future__ import annotations

from pathlib import Path

from testbed.numbers.reproduction import JUDGED, Judged
from testbed.plan.headline import Line, read_headline
from testbed.present.reproduction import figure_of, name_of

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reproduce.md"


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
