"""Two results beside each other: in what they differ, by how much, and what cannot be told."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from testbed.fly.results import Series, new_series
from testbed.present.report import compare
from testbed.present.report.compare_page import print_comparison, write_comparison
from tests.handmade.both_sides import entry, failed, make_series
from tests.handmade.pages import sketched_papers

BOTH = ("mqttxt", entry("mqttxt")), ("mavlink", entry("mavlink"))


def result(name: str, folder: Path, *entries: tuple[str, dict[str, Any]], **changed: Any) -> compare.ComparedSeries:
    """A series whose manifests have what is `changed`; so has `configuration`."""
    series = new_series(folder / name, "scenario-1", "thesis", "ideal")
    conditions = {key: value for key, value in changed.items() if key in ("arm", "profile", "shaper", "experiment")}
    metrics = make_series(series, *entries, **conditions)
    for attempt in series.attempts():
        path = attempt.path / "manifest.json"
        told = json.loads(path.read_text())
        told["configuration"] |= changed.get("configuration", {})
        told |= {key: value for key, value in changed.items() if key != "configuration"}
        path.write_text(json.dumps(told))
    return compare.result_of(name, series, metrics)


@pytest.fixture
def first(tmp_path: Path) -> compare.ComparedSeries:
    return result("A", tmp_path, *BOTH)


def test_the_same_way_of_flying_is_said(tmp_path: Path, first: compare.ComparedSeries) -> None:
    again = result("B", tmp_path, ("mqttxt", entry("mqttxt")), ("mavlink", entry("mavlink", packets=901_000)))
    said = compare.sentences(first, again)
    assert said[0] == "Both were flown in the same way: what differs is chance, or the machine."
    assert said[1].startswith("From A to B over MQTT-XT: packets the same, bytes the same")
    assert said[2].startswith("From A to B over MAVLink: packets ×2.0, bytes the same")


def test_one_factor_is_named_and_several_cannot_be_told_apart(tmp_path: Path, first: compare.ComparedSeries) -> None:
    one = result("B", tmp_path, *BOTH, configuration={"commanding": "concurrent"})
    assert compare.sentences(first, one)[0] == "They differ in commanding."
    assert not any("do not show what made the numbers differ" in said for said in compare.sentences(first, one))
    several = result("C", tmp_path, *BOTH, profile="lte", shaper="netem", configuration={"qos": 1})
    said = compare.sentences(first, several)
    assert said[0] == "They differ in profile, shaper and qos."
    assert "do not show what made the numbers differ" in said[-1]


def test_another_fleet_is_named_with_the_drones_of_each_fog(tmp_path: Path, first: compare.ComparedSeries) -> None:
    fogs = {"fog2": ("uav7", "uav1"), "fog5": ("uav3",)}
    links = [{"name": f"air:{uav}", "lower": uav, "upper": fog} for fog, uavs in fogs.items() for uav in uavs]
    links.append({"name": "wan:gs", "lower": "gs", "upper": "cloud"})
    names = ("gs", "cloud", *fogs, *(uav for uavs in fogs.values() for uav in uavs))
    nodes = [{"name": name, "address": f"198.18.{place}.3"} for place, name in enumerate(names)]
    size = {"fogs": 2, "drones": 3}
    other = result("B", tmp_path, *BOTH, configuration=size, topology={"nodes": nodes, "links": links})
    assert compare.sentences(first, other)[0] == "They differ in fleet."
    fleet = next(c for c in compare.conditions(first, other) if c.name == "fleet")
    assert fleet.second == "three drones on two fogs (2, 1)"
    assert compare.title(first) == "scenario 1, arm thesis, profile ideal"
    assert compare.title(other) == "scenario 1, arm thesis, profile ideal, three drones on two fogs"


def test_revisions_are_never_mixed_unsaid(tmp_path: Path, first: compare.ComparedSeries) -> None:
    revision = {"commit": "decaf", "dirty": True}
    other = result("B", tmp_path, *BOTH, revision=revision)
    assert compare.sentences(first, other)[0] == "They differ in revision."
    found = next(c for c in compare.conditions(first, other) if c.name == "revision")
    assert (found.first, found.second) == ("c0ffee", "decaf with changes")


def test_another_experiment_does_not_compare(tmp_path: Path, first: compare.ComparedSeries) -> None:
    other = result("B", tmp_path, *BOTH, experiment="scenario-3")
    assert "These are different experiments, so their totals do not compare." in compare.sentences(first, other)


def test_a_side_that_only_one_has_is_said_and_makes_no_row(tmp_path: Path, first: compare.ComparedSeries) -> None:
    other = result("B", tmp_path, ("mqttxt", failed("mqttxt", "denied")))
    assert "Only one of them flew MAVLink." in compare.sentences(first, other)
    rows = compare.rows(first, other)
    assert {row.protocol for row in rows} == {"mqttxt"}
    assert all(row.change is None for row in rows)


@pytest.mark.parametrize(
    ("ratio", "said"),
    [(1.004, "the same"), (1.12, "+12 %"), (0.66, "−34 %"), (3.4, "×3.4"), (0.002, "−99.8 %"), (1.006, "+0.6 %")],
)
def test_a_change_has_the_digits_that_it_deserves(ratio: float, said: str) -> None:
    assert compare.change(ratio) == said


@pytest.mark.long
def test_the_terminal_and_the_page_say_the_same_and_the_page_twice_so(
    tmp_path: Path, first: compare.ComparedSeries
) -> None:
    other = result("B", tmp_path, ("mavlink", entry("mavlink", packets=4505)), configuration={"streams": "five-states"})
    console = Console(file=StringIO(), width=100)
    print_comparison(first, other, console)
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert "They differ in streams." in shown
    assert "−99.0 %" in shown
    page = tmp_path / "page" / "compare.html"
    write_comparison(first, other, page)
    text = page.read_text()
    assert "They differ in streams." in text
    assert "−99.0 %" in text
    before = {path: path.read_bytes() for path in page.parent.iterdir()}
    assert {path.name for path in before} == {"compare.html", "compare.csv", "compare.pdf"}
    write_comparison(first, other, page)
    assert {path: path.read_bytes() for path in page.parent.iterdir()} == before


def test_each_result_links_to_its_own_report(tmp_path: Path, first: compare.ComparedSeries) -> None:
    (first.series.path / "report.html").write_text("")
    page = tmp_path / "compare.html"
    with sketched_papers():
        write_comparison(first, compare.ComparedSeries("B", Series(tmp_path), first.metrics, first.manifests), page)
    link = f'href="{first.series.path.relative_to(tmp_path)}/report.html"'
    assert link in page.read_text()
    assert page.read_text().count("report.html") == 1
