"""The page and the terminal of one protocol's series: what they say, and that they say it the same way twice."""

from __future__ import annotations

import re
import shutil
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from testbed.fly.progress import ConsoleProgress
from testbed.fly.results import Series, new_series
from testbed.numbers import words
from testbed.numbers.metrics import measure_series
from testbed.present.report.html import write_report
from testbed.present.report.sentences import finding
from testbed.present.report.terminal import print_summary
from tests.handmade.attempts import make_attempt
from tests.handmade.pages import cells_of, terminal_of


@pytest.fixture
def series(series: Series) -> Series:
    make_attempt(series)
    make_attempt(series, number=2, status="failed", reason="takeoff: drone 1: <denied>")
    make_attempt(series, number=3, dropped=1)
    return series


def test_the_page_says_what_happened_and_is_self_contained(series: Series) -> None:
    page = write_report(series, measure_series(series)).read_text()
    assert "Over MQTT-XT one drone on one fog flew scenario 1 in 9.0 s, with 7 packets" in page
    assert "takeoff: drone 1: &lt;denied&gt;" in page
    assert "captures dropped packets: gs 1" in page
    assert "MQTT-XT, attempt 2 failed." in page
    assert "MQTT-XT, attempt 3 is void, not counted." in page
    assert not re.search(r"""(src|href)=["'](https?:)?//""", page)
    links = re.findall(r'href="([^"#]+)"', page)
    assert "mqttxt/attempt-01/pcap/gs.pcap" in links
    assert all((series.path / link).exists() for link in links)


@pytest.mark.parametrize("file", ["manifest.json", "events.jsonl"])
def test_a_damaged_attempt_is_void_and_keeps_nobody_from_seeing_the_others(series: Series, file: str) -> None:
    damaged = series.path / "mqttxt" / "attempt-00"
    shutil.copytree(series.path / "mqttxt" / "attempt-01", damaged)
    (damaged / file).write_text("{half\n")
    metrics = measure_series(series)
    assert "Over MQTT-XT one drone on one fog flew scenario 1" in write_report(series, metrics).read_text()
    assert f"MQTT-XT, attempt 0 is void, not counted: mqttxt/attempt-00/{file}" in terminal_of(series, metrics)


@pytest.mark.parametrize("file", ["counters.json", "plan.json", "events.jsonl"])
def test_a_damaged_record_of_the_links_is_remarked_and_the_page_is_written(series: Series, file: str) -> None:
    (series.path / "mqttxt" / "attempt-01" / "links" / file).write_text("{half\n")
    metrics = measure_series(series)
    terminal_of(series, metrics)
    assert re.search(rf"links/{file}(, line 1)?: not JSON", write_report(series, metrics).read_text())


def test_the_terminal_shows_every_attempt_and_link(series: Series) -> None:
    shown = terminal_of(series, measure_series(series))
    rows = cells_of(shown)
    assert ["MQTT-XT", "1", "completed", "9.0 s", "7", "575 B"] in [row[:6] for row in rows]
    assert ["MQTT-XT", "2", "failed"] in [row[:3] for row in rows]
    assert ["MQTT-XT", "3", "void"] in [row[:3] for row in rows]
    assert "MQTT-XT, attempt 2 failed: takeoff: drone 1: <denied>" in shown
    assert "MQTT-XT, attempt 3 is void, not counted: captures dropped packets: gs 1" in shown
    assert ["air:uav1", "2 / 1", "139 B / 86 B", "1"] in rows


_MB = [(999_499, "999 kB"), (999_500, "1.00 MB"), (1_534_000, "1.53 MB")]


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0, "0 B"), (999, "999 B"), (999.6, "1.00 kB"), (6000, "6.00 kB"), (9996, "10.0 kB"), (167_340, "167 kB"), *_MB],
)
def test_sizes_have_three_digits(value: float, shown: str) -> None:
    assert words.size(value) == shown


@pytest.mark.parametrize(
    ("share", "of", "shown"),
    [
        (None, 0, "–"),
        (0.0, 3, "0 of 3"),
        (0.0, 300, "0 of 300 (< 1 %)"),
        (0.25, 8, "25 % of 8"),
        (1.0, 6, "100 % of 6"),
    ],
)
def test_no_loss_is_given_with_its_bound(share: float | None, of: int, shown: str) -> None:
    assert words.loss(share, of) == shown


@pytest.mark.parametrize(
    ("value", "shown"),
    [(264.7, "265"), (1234.5, "1,234"), (9.96, "10"), (1.64, "1.6"), (1.02, "1.02"), (0.62, "0.62"), (0.0123, "0.012")],
)
def test_ratios_have_the_digits_that_they_deserve(value: float, shown: str) -> None:
    assert words.ratio(value) == shown


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (265, "265 times the bytes"),
        (0.996, "1.00 times the bytes"),
        (0.99, "99 % of the bytes"),
        (0.04, "4.0 % of the bytes"),
    ],
)
def test_a_ratio_below_one_is_said_as_a_part(value: float, shown: str) -> None:
    assert words.times(value, "the bytes") == shown


def test_a_log_in_a_reason_is_shown_as_it_is(tmp_path: Path) -> None:
    made = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    reason = "uav3 ended with exit code 1; its last log lines:\n    [/run/mqttxt/ready] [red]gone"
    make_attempt(made, status="failed", reason=reason)
    console = Console(file=StringIO(), width=120)
    print_summary(made, measure_series(made), console)
    ConsoleProgress(console).ended("failed", reason)
    assert console.file.getvalue().count("[/run/mqttxt/ready] [red]gone") == 2  # type: ignore[attr-defined]


def test_none_that_counts_is_said(tmp_path: Path) -> None:
    made = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    make_attempt(made, dropped=1)
    assert (
        finding(measure_series(made))
        == "Over MQTT-XT no attempt counts (captures dropped packets: gs 1, cloud 1, fog1 1, uav1 1)."
    )
    make_attempt(made, number=2, status="failed", reason="denied")
    assert finding(measure_series(made)) == "Over MQTT-XT the only attempt failed (denied)."


@pytest.mark.parametrize(
    ("value", "shown"),
    [(None, "–"), (1.234, "1.23 ms"), (9.996, "10 ms"), (123.4, "123 ms"), (999.6, "1.00 s"), (7104.0, "7.10 s")],
)
def test_delays_have_sensible_digits(value: float | None, shown: str) -> None:
    assert words.milliseconds(value) == shown
