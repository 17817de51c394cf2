"""Requirements for CI: what they can say, and what is said of those that lead nowhere."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from testbed.cli.commands import app
from testbed.errors import UserError
from testbed.fly.results import Series, new_series
from testbed.numbers.metrics.series import measure_series
from testbed.numbers.metrics.verdict import parse
from tests.handmade.attempts import make_attempt

SEVEN = "mqttxt.packets"
"""The tiny attempt's seven packets; its arm command took 2.5 ms."""


def tiny(root: Path) -> Series:
    made = new_series(root, "scenario-1", "thesis", "ideal")
    make_attempt(made)
    return made


@pytest.fixture
def series(tmp_path: Path) -> Series:
    return tiny(tmp_path)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Series:
    """A series whose metrics are there, for tests that only read them."""
    made = tiny(tmp_path_factory.mktemp("measured"))
    measure_series(made)
    return made


def verdict(series: Series, *requirements: str) -> tuple[int, list[str], str]:
    options = [word for text in requirements for word in ("--require", text)]
    result = CliRunner().invoke(app, ["verdict", str(series.path), *options])
    assert isinstance(result.exception, SystemExit | None)
    return result.exit_code, result.stdout.splitlines(), result.stderr


@pytest.mark.parametrize(
    ("text", "met", "value"),
    [
        (f"{SEVEN}>=7", True, "7"),
        (f"{SEVEN}>7", False, "7"),
        (f"{SEVEN} < 7.5", True, "7"),
        (f"{SEVEN}<=6", False, "7"),
        (f"{SEVEN}==7", True, "7"),
        (f"{SEVEN}!=7", False, "7"),
        ("mqttxt.delay_ms.arm<=2.5", True, "2.5"),
        ("mqttxt.max.delay_ms.arm<2.5e0", False, "2.5"),
        ("mqttxt.wire_loss<=15%", True, "0.142857143"),
        ("mqttxt.wire_loss <= 14 %", False, "0.142857143"),
        ("mqttxt.links.air:uav1:up.lost<=1", True, "1"),
        ("mqttxt.load.total.4>=0", True, "85"),
        ("mqttxt.completed>=1", True, "1"),
        ("mqttxt.void<=0", True, "0"),
        ("statistics.metrics.mission_s.mqttxt.median<=9", True, "9"),
        ("protocols.mqttxt.attempts.0.packets==7", True, "7"),
        ("statistics.metrics.packets.test.p<0.05", False, "nothing was measured"),
        ("ratios.packets>=50", False, "nothing was measured"),
        ("mqttxt.messages.states.battery.lost<=0", True, "0"),
    ],
)
def test_a_requirement_is_a_line_and_the_exit_code_says_whether_it_is_met(
    measured: Series, text: str, met: bool, value: str
) -> None:
    code, lines, _ = verdict(measured, text)
    assert lines == [f"{'met' if met else 'not met'}: {text}: {value}"]
    assert code == (0 if met else 1)


def test_all_requirements_are_answered_although_one_is_not_met(measured: Series) -> None:
    code, lines, _ = verdict(measured, f"{SEVEN}>=8", f"{SEVEN}>=7")
    assert (code, [line.split(":")[0] for line in lines]) == (1, ["not met", "met"])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("ratio.packets>=50", "there is no ratio in metrics.json; there is mqttxt, protocols, ratios, statistics"),
        ("mavlink.packets>=50", "there is no mavlink in metrics.json"),
        ("mqttxt.packet>=50", "there is no packet in mqttxt; there is "),
        ("mqttxt.delay_ms.goto>=50", "there is no goto in mqttxt.delay_ms; there is arm"),
        ("mqttxt.delay_ms>=50", "mqttxt.delay_ms is no number; there is arm"),
        ("mqttxt.status>=50", "mqttxt.status is no number"),
        ("mqttxt>=50", "mqttxt is no number"),
        ("mqttxt.max>=50", "mqttxt is no number"),
        ("protocols.mqttxt.attempts.1.packets>=7", "there is no 1 in protocols.mqttxt.attempts; there is 0"),
        ("protocols.mqttxt.attempts.0.load.total>=7", "is a list, expected a number"),
        ("ratios.sise>=50", "there is no sise in ratios"),
        ("ratios.packets", "expected PATH, one of >= <= == != > <, and a number, as ratios.packets>=50"),
        ("ratios.packets>=", "expected PATH"),
        (">=5", "expected PATH"),
        ("ratios.packets=>5", "expected PATH"),
        ("ratios.packets>=five", "expected PATH"),
        ("ratios.packets>=1e999", "1e999 is too large a number"),
        ("__import__('os').system('id')>=5", "there is no __import__('os') in metrics.json"),
    ],
)
def test_what_leads_nowhere_is_named_with_what_there_is(measured: Series, text: str, said: str) -> None:
    code, lines, error = verdict(measured, f"{SEVEN}>=7", text)
    assert (code, lines) == (2, [])
    assert said in error
    assert len(error.splitlines()) == 1


@pytest.mark.long
def test_the_median_of_the_completed_attempts_is_meant(series: Series) -> None:
    make_attempt(series, number=2)
    make_attempt(series, number=3, status="failed", reason="takeoff: denied")
    lines = verdict(series, "mqttxt.mission_s<=9", "mqttxt.failed<=0", "mqttxt.flown==3")[1]
    assert lines == ["met: mqttxt.mission_s<=9: 9", "not met: mqttxt.failed<=0: 1", "met: mqttxt.flown==3: 3"]


def test_without_a_completed_attempt_nothing_is_met(tmp_path: Path) -> None:
    made = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    make_attempt(made, status="failed", reason="takeoff: denied")
    code, lines, _ = verdict(made, "mqttxt.packets>=0")
    assert (code, lines) == (1, ["not met: mqttxt.packets>=0: nothing was measured"])


def test_metrics_that_are_there_are_read_and_not_made_again(series: Series) -> None:
    verdict(series, f"{SEVEN}>=7")
    path = series.path / "metrics.json"
    told = json.loads(path.read_text())
    told["protocols"]["mqttxt"]["attempts"][0]["packets"] = 70
    path.write_text(json.dumps(told))
    assert verdict(series, f"{SEVEN}==70")[0] == 0


def test_metrics_of_another_version_are_said_to_be_such(series: Series) -> None:
    path = series.path / "metrics.json"
    path.write_text('{"version": 1}')
    code, _, error = verdict(series, f"{SEVEN}>=7")
    assert code == 1
    assert "metrics.json: made by another version" in error
    assert f"type: testbed report {series.path}" in error


@given(st.text(max_size=40))
def test_no_text_raises_anything_but_a_line(text: str) -> None:
    with contextlib.suppress(UserError):
        assert parse(text).text == text.strip()
