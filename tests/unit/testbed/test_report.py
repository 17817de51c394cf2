"""The page and the terminal: what they say, and that they say it the same way twice."""

from __future__ import annotations

import re
from io import StringIO
from pathlib import Path

import pytest
from attempts import make_attempt
from rich.console import Console

from testbed.metrics import measure_series
from testbed.report import words
from testbed.report.html import write_report
from testbed.report.terminal import print_summary
from testbed.results import Series, new_series, open_series


@pytest.fixture
def series(tmp_path: Path) -> Series:
    made = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    make_attempt(made)
    make_attempt(made, number=2, status="failed", reason="takeoff: drone 1: <denied>")
    make_attempt(made, number=3, dropped=1)
    return made


def test_the_page_says_what_happened_and_is_self_contained(series: Series) -> None:
    page = write_report(series, measure_series(series)).read_text()
    assert "Over MQTT-XT 1 drones on two fogs flew scenario 1 in 9.0 s, with 7 packets" in page
    assert "takeoff: drone 1: &lt;denied&gt;" in page
    assert "void, not counted" in page
    assert not re.search(r"""(src|href)=["'](https?:)?//""", page)
    links = re.findall(r'href="([^"#]+)"', page)
    assert "mqttxt/attempt-01/pcap/gs.pcap" in links
    assert all((series.path / link).exists() for link in links)


def test_the_same_results_give_the_same_bytes(series: Series) -> None:
    first = write_report(series, measure_series(series)).read_bytes()
    metrics = (series.path / "metrics.json").read_bytes()
    (series.path / "metrics.json").unlink()
    (series.path / "report.html").unlink()
    again = open_series(series.path)
    assert write_report(again, measure_series(again)).read_bytes() == first
    assert (series.path / "metrics.json").read_bytes() == metrics


def test_the_terminal_shows_every_attempt_and_link(series: Series) -> None:
    console = Console(file=StringIO(), width=120)
    print_summary(series, measure_series(series), console)
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in shown.splitlines() if line.startswith("│")]
    assert ["MQTT-XT", "1", "completed", "9.0 s", "7", "572 B"] in [row[:6] for row in rows]
    assert ["MQTT-XT", "2", "failed"] in [row[:3] for row in rows]
    assert ["MQTT-XT", "air:uav1", "2", "1", "139 B", "85 B", "1"] in rows


@pytest.mark.parametrize(
    ("value", "shown"), [(0, "0 B"), (999, "999 B"), (1000, "1 kB"), (167_340, "167 kB"), (1_534_000, "1.53 MB")]
)
def test_sizes_have_three_digits(value: int, shown: str) -> None:
    assert words.size(value) == shown


@pytest.mark.parametrize(
    ("share", "of", "shown"),
    [(None, 0, "–"), (0.0, 3, "0 of 3"), (0.0, 300, "0 of 300 (< 1 %)"), (0.25, 8, "25 % of 8")],
)
def test_no_loss_is_given_with_its_bound(share: float | None, of: int, shown: str) -> None:
    assert words.loss(share, of) == shown


@pytest.mark.parametrize(("value", "shown"), [(None, "–"), (1.234, "1.23 ms"), (123.4, "123 ms"), (7104.0, "7.10 s")])
def test_delays_have_sensible_digits(value: float | None, shown: str) -> None:
    assert words.milliseconds(value) == shown
