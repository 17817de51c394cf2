"""The report in a browser: whole at 400 pixels and at 1200, in light and dark, with nothing to complain of."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from testbed.fly.results import new_series
from testbed.present.report.compare import result_of
from testbed.present.report.compare_page import write_comparison
from testbed.present.report.html import write_report
from tests.handmade.both_sides import entry, failed, make_series, rich_entry
from tests.rigs.browser import Browser
from tests.tools.programs import chromium

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(chromium() is None, reason="no Chromium; `make tools` has it"),
]
PHONE, DESK = 400, 1200
A4 = 688
"""Pixels between the margins of 14 mm."""
LEAST_TEXT = 9.0
"""Pixels below which a figure's text cannot be read."""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A full report with shaped links and much to say, one of a lone failure, and a comparison."""
    made = {}
    full = new_series(tmp_path_factory.mktemp("full"), "scenario-1", "thesis", "thesis")
    several = [(p, rich_entry(p, n)) for p in ("mqttxt", "mavlink") for n in range(1, 8)]
    reason = "air:uav3:up loss: configured 2 %, measured 4.1 % (412 of 10,000 frames); expected 158 to 246, " * 2
    void = {**entry("mqttxt", 9), "status": "void", "reason": reason}
    metrics = make_series(full, *several, ("mavlink", failed("mavlink", reason, 8)), ("mqttxt", void))
    made["full"] = write_report(full, metrics | {"shaper": "nfqueue", "profile": "thesis"})
    lone = new_series(tmp_path_factory.mktemp("lone"), "scenario-1", "thesis", "ideal")
    lone_metrics = make_series(lone, ("mqttxt", failed("mqttxt", "vehicle 3 never appeared")))
    made["lone failure"] = write_report(lone, lone_metrics)
    made["comparison"] = tmp_path_factory.mktemp("both") / "compare.html"
    results = [result_of(name, one, m) for name, one, m in (("A", full, metrics), ("B", lone, lone_metrics))]
    write_comparison(results[0], results[1], made["comparison"])
    return made


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [PHONE, DESK])
@pytest.mark.parametrize("name", ["full", "lone failure", "comparison"])
def test_a_page_fits_its_width_and_complains_of_nothing(
    browser: Browser, pages: dict[str, Path], name: str, width: int, dark: bool
) -> None:
    browser.said.clear()
    look = browser.look(pages[name], width, dark)
    assert browser.said == []
    assert look.wider == ()
    assert look.scroll_width == width
    assert min(look.text_sizes, default=LEAST_TEXT) >= LEAST_TEXT
    assert (_light(look.background) < 0.1) == dark
    assert _contrast(look.ink, look.background) > 7


@pytest.mark.parametrize("name", ["full", "lone failure", "comparison"])
def test_on_paper_a_page_is_whole_and_light(browser: Browser, pages: dict[str, Path], name: str) -> None:
    look = browser.look(pages[name], A4, dark=True, paper=True)
    assert look.wider == ()
    assert look.cut == ()
    assert _light(look.background) > 0.9


def test_each_figure_is_there_once_at_every_width(browser: Browser, pages: dict[str, Path]) -> None:
    page = pages["full"].read_text()
    figures = len(re.findall(r' id="[a-z0-9-]+-wide-title"', page))
    assert figures >= 11
    closed = len(re.findall(r"<details><summary>MAVLink|<details><summary>MQTT-XT", page))
    for width in (PHONE, DESK):
        shown = browser.look(pages["full"], width).visible_figures
        assert figures - closed <= shown <= figures


def _light(colour: str) -> float:
    """The relative luminance of `rgb(r, g, b)` as WCAG defines it, 0 to 1."""
    parts = [int(part) / 255 for part in re.findall(r"\d+", colour)[:3]]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(one: str, other: str) -> float:
    high, low = sorted((_light(one), _light(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)
