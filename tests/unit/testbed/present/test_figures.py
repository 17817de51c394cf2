"""Figures: what is drawn where, what their data say, and the same bytes each time."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from testbed.fly.results import Series, new_series
from testbed.numbers.quantity import QuantityFigure
from testbed.present.report.details import LinkFigure
from testbed.present.report.figures import attempts, axes, delays, files, losses, parts, sizes, topology, traffic
from testbed.present.report.figures.draw import NARROW, WIDE, Drawing, svg
from testbed.present.report.figures.figure import Figure
from testbed.present.report.figures.flights import flights, flights_of
from testbed.present.report.figures.pdf import LIGHT, pdf
from testbed.present.report.html import write_report
from tests.handmade.both_sides import entry, failed, make_series, rich_entry

SECOND = 1_000_000_000


def rows_of(figure: Figure) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(figure.csv())))


def test_a_drawing_is_svg_that_says_what_it_shows_and_keeps_text_as_text() -> None:
    drawing = Drawing(100, 50)
    drawing.text(10, 20, "5 < 6 & more", anchor="end")
    drawing.dot((1, 2), "mavlink", tip="a <tip>")
    drawing.rect(0, 0, 10, 5, "mqttxt", opacity=0.5)
    drawn = ElementTree.fromstring(svg(drawing, "it", "A title", "A sentence."))
    assert drawn.attrib["aria-labelledby"] == "it-title it-desc"
    assert [element.text for element in drawn.iter() if element.tag in ("title", "desc", "text")] == [
        *("A title", "A sentence.", "5 < 6 & more", "a <tip>"),
    ]
    assert not {"style", "fill", "stroke"} & {name for element in drawn.iter() for name in element.attrib}


def test_every_colour_has_a_value_on_paper_and_on_the_page() -> None:
    page = Path(svg.__code__.co_filename).parents[1] / "page"
    style = (page / "style.css").read_text()
    assert all(f"--{role}:" in style for role in LIGHT)
    named = re.findall(r"'([a-z0-9]+)'", (page / "figures.css").read_text().splitlines()[0])
    assert set(named) == set(LIGHT)


def test_mavlinks_marks_are_diamonds_so_that_no_one_needs_the_colours() -> None:
    drawing = Drawing(10, 10)
    drawing.dot((5, 5), "mqttxt")
    drawing.dot((5, 5), "mavlink")
    text = svg(drawing, "it", "", "")
    assert text.count("<circle") == 1
    assert text.count("<path") == 1


@pytest.mark.parametrize(
    ("values", "bounds"), [([3, 40], (1, 100)), ([10, 100], (10, 100)), ([0, 5], (1, 10)), ([], (1, 10))]
)
def test_a_logarithmic_scale_has_whole_decades(values: list[float], bounds: tuple[float, float]) -> None:
    assert axes.log_bounds(values) == bounds


def test_a_scale_without_extent_maps_its_only_value_to_the_start() -> None:
    assert axes.Scale(0.0, 0.0, 10.0, 90.0)(0.0) == 10.0


def test_steps_are_round() -> None:
    assert [value for value, _ in axes.steps(64, str, 5)] == [0, 20, 40, 60]
    assert [value for value, _ in axes.steps(0.5, str, 5)] == [0, 0.1, 0.2, 0.30000000000000004, 0.4, 0.5]


def test_an_outcome_belongs_to_the_call_for_its_fog_and_one_without_lasts_to_the_end() -> None:
    events = [
        {"t_ns": 0, "event": "step", "name": "arm"},
        {"t_ns": 0, "event": "command", "call": 1, "command": "arm", "fog": 1, "drone": None},
        {"t_ns": SECOND, "event": "outcome", "call": 1, "drone": 1, "word": "completed", "final": True},
        {"t_ns": SECOND, "event": "step_done", "name": "arm", "ok": True},
        {"t_ns": 2 * SECOND, "event": "command", "call": 2, "command": "land", "fog": 1, "drone": 2},
    ]
    heights = {f"uav{n}": [{"t_ns": 0, "event": "position", "altitude_m": 2.0}] for n in (1, 2)}
    side = flights_of("mqttxt", heights, events, 0, 5.0, True)
    assert [(call.command, call.start_s, call.end_s, call.ok) for call in side.calls["1"]] == [("arm", 0, 1, True)]
    assert [(call.command, call.end_s, call.ok) for call in side.calls["2"]] == [("land", None, False)]
    figure = flights([side])
    assert figure is not None
    assert [row["word"] for row in rows_of(figure) if row["what"] == "land"] == ["no last word"]


def commands_of(number: int, lost: int = 0) -> dict[str, Any]:
    delays_ms, messages = {"land": [3.0], "arm": [1.0, 2.0]}, {"arm": {"lost": lost}, "land": {"lost": 0}}
    return {"attempt": number, "delay_ms": delays_ms, "delay_app_ms": {}, "messages": {"commands": messages}}


def test_delays_keep_the_order_of_the_mission_and_know_their_attempt() -> None:
    kinds = delays.delays_of({"mqttxt": [commands_of(1), commands_of(3)]}, ["arm", "land"])
    assert list(kinds) == ["arm", "land"]
    assert kinds["arm"]["mqttxt"].attempts == (1, 1, 3, 3)
    figure = delays.distribution(kinds)
    assert figure is not None
    assert [row["share_within"] for row in rows_of(figure) if row["command"] == "arm"] == ["0.25", "0.5", "0.75", "1"]


def test_a_lost_command_has_not_arrived_within_any_time() -> None:
    kinds = delays.delays_of({"mavlink": [commands_of(1, lost=2)]}, ["arm", "land"])
    figure = delays.distribution(kinds)
    assert figure is not None
    assert [row["share_within"] for row in rows_of(figure)] == ["0.25", "0.5", "1"]


def test_packet_sizes_are_shares_of_each_sides_own() -> None:
    counts = {"mqttxt": (0, 0, 3, 1, 0, 0, 0, 0, 0), "mavlink": (0, 0, 0, 400, 0, 0, 0, 0, 0)}
    figure = sizes.histogram(counts)
    assert figure is not None
    assert [(row["protocol"], row["from_bytes"], row["packets"], row["share"]) for row in rows_of(figure)] == [
        *(("mqttxt", "40", "3", "0.75"), ("mqttxt", "80", "1", "0.25")),
        *(("mavlink", "40", "0", "0"), ("mavlink", "80", "400", "1")),
    ]


def test_traffic_adds_both_ways_in_the_drawing_and_keeps_them_apart_in_the_data() -> None:
    figure = traffic.traffic({"mqttxt": {"wan:gs:up": (100, 0, 7), "wan:gs:down": (900, 0, 7)}}, {}, {"mqttxt": 2.5})
    assert figure is not None
    assert len(figure.rows) == 6
    drawn = figure.draw(WIDE)
    assert any(getattr(mark, "words", "") == "wan:gs" for mark in drawn.marks)


def test_loss_is_named_by_its_cause_and_none_draws_nothing() -> None:
    lost = losses.Lost(200, {"queue": 18, "random": 2})
    sides = {"mavlink": {"air:uav1:up": lost, "air:uav1:down": losses.Lost(10, {})}}
    assert losses.said(sides) == (
        "Frames lost: over MAVLink 20 of 210 (2 drawn at random and 18 no room in the queue)."
    )
    assert losses.losses({"mavlink": {"air:uav1:down": losses.Lost(10, {})}}, True) is None
    figure = losses.losses(sides, False)
    assert figure is not None
    assert "in the whole run, probes included" in figure.note
    assert (rows_of(figure)[0]["queue"], rows_of(figure)[0]["entered"]) == ("18", "200")


def test_a_failed_attempt_is_a_cross_and_never_a_time() -> None:
    flown = [attempts.MissionTime(1, 36.0, "completed", None), attempts.MissionTime(2, None, "failed", "denied")]
    figure = attempts.mission_time(
        {"mqttxt": flown}, {"mqttxt": QuantityFigure("36.0 s", 36.0, {1: 36.0})}, {"mqttxt": 44}
    )
    assert figure is not None
    assert [(row["status"], row["mission_s"], row["reason"]) for row in rows_of(figure)] == [
        *(("completed", "36", ""), ("failed", "", "denied")),
    ]
    tips = [getattr(mark, "tip", "") for mark in figure.draw(WIDE).marks]
    assert "MQTT-XT, attempt 2: failed, denied" in tips


def test_the_topology_has_a_place_for_every_node_and_says_what_was_measured() -> None:
    way = {"delay_ms": LinkFigure(25.0, 25.2, None), "loss": LinkFigure(0.01, 0.0, None)}
    links = [
        topology.DrawnLink("wan:gs", "gs", "cloud", way, {}),
        topology.DrawnLink("backhaul:fog1", "fog1", "cloud", {}, {}),
        topology.DrawnLink("air:uav1", "uav1", "fog1", {}, {}),
        topology.DrawnLink("sense:uav1", "sensor1", "uav1", {}, {}),
    ]
    figure = topology.topology(links, "lte", "netem")
    assert figure is not None
    for width in (WIDE, NARROW):
        said = [getattr(mark, "words", "") for mark in figure.draw(width).marks]
        assert {"gs", "cloud", "fog1", "uav1", "sensor1", "↑ 25 ms"} <= set(said)


def test_parts_are_whole() -> None:
    figure = parts.parts("layers", "Bytes", "", ["a", "b"], {"mqttxt": {"a": 1, "b": 3}, "mavlink": {}})
    assert figure is not None
    assert [(row["part"], row["share"]) for row in rows_of(figure)] == [("a", "0.25"), ("b", "0.75")]


@pytest.mark.long
def test_a_pdf_is_the_same_each_time_and_has_its_text_and_fonts() -> None:
    drawing = Drawing(200, 100)
    drawing.text(10, 20, "$5")
    drawing.dot((5, 5), "mavlink", hollow=True)
    drawing.path([(0, 0), (9, 9)], "mqttxt", dashed=True)
    once, again = pdf(drawing, "A title"), pdf(drawing, "A title")
    assert once == again
    assert once.startswith(b"%PDF")
    assert b"FontFile2" in once
    assert b"CreationDate" not in once


def full(folder: Path) -> tuple[Series, dict[str, object]]:
    series = new_series(folder, "scenario-1", "thesis", "ideal")
    several = [(p, rich_entry(p, n)) for p in ("mqttxt", "mavlink") for n in (1, 2)]
    void = {**entry("mqttxt", 3), "status": "void", "reason": "captures dropped packets: gs 1"}
    return series, make_series(series, *several, ("mavlink", failed("mavlink", "denied", 3)), ("mqttxt", void))


@pytest.mark.long
def test_the_same_results_at_another_path_give_the_same_files(tmp_path: Path) -> None:
    series, metrics = full(tmp_path / "here")
    written = write_report(series, metrics).parent
    elsewhere = tmp_path / "elsewhere" / "copied by hand"
    elsewhere.parent.mkdir()
    written.rename(elsewhere)
    before = {path: path.read_bytes() for path in elsewhere.rglob("*") if path.suffix in (".html", ".csv")}
    assert {path.stem for path in before} >= {"flights", "traffic", "loss", "mission-time", "scenarios", "topology"}
    for path in before:
        path.unlink()
    write_report(Series(elsewhere), metrics)
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.long
def test_every_figure_has_its_data_and_its_paper_beside_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "pdf", lambda drawing, title: title.encode())
    series, metrics = full(tmp_path)
    page = write_report(series, metrics, papers=True)
    named = set(re.findall(r'href="(figures/[^"]+)"', page.read_text()))
    assert named == {f"figures/{path.name}" for path in (page.parent / "figures").iterdir()}
    assert {Path(name).suffix for name in named} == {".csv", ".pdf"}


@pytest.mark.long
def test_what_is_not_drawn_any_more_leaves_no_file(tmp_path: Path) -> None:
    series, metrics = full(tmp_path)
    write_report(series, metrics)
    assert (series.path / "figures" / "loss.csv").exists()
    for side in metrics["protocols"].values():  # type: ignore[attr-defined]
        for attempt in side["attempts"]:
            attempt["losses"] = {"links": {}}
    assert "No link lost a frame" in write_report(series, metrics).read_text()
    assert not (series.path / "figures" / "loss.csv").exists()
