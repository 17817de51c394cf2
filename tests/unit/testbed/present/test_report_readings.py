"""The report on sensors: each series of both sides, what is missing by name, what carrying took, the thesis beside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from testbed.fly.results import Series, new_series
from testbed.numbers.metrics.readings import MeasuredValue
from testbed.present.report import comparison, readings, thesis, thesis_rows
from testbed.present.report.figures import readings as figures
from tests.handmade.both_sides import entry, make_series
from tests.handmade.pages import page_of, terminal_of

UNITS = {"temperature": "degC", "humidity": "%", "light": "lx"}
SUMMARY = {"n": 5, "mean": 5.0, "p50": 5.0, "p90": 6.0, "p99": None, "max": 7.0}
NONE = {"n": 0, **dict.fromkeys(("mean", "p50", "p90", "p99", "max"))}
START_NS = 1_000_000_000_000


@pytest.fixture
def series(tmp_path: Path) -> Series:
    return new_series(tmp_path, "scenario-4", "thesis", "ideal")


def one_series(drone: int, kind: str, delivered: int = 5, measured: int = 5, wrong: int = 0) -> dict[str, Any]:
    return {
        **{"drone": drone, "sensor": drone, "kind": kind, "unit": UNITS[kind], "samples": 5, "measured": measured},
        **{"delivered": delivered, "wrong": wrong, "whole": delivered == measured == 5 and not wrong},
        **{"delay_ms": SUMMARY if delivered else NONE, "delay_app_ms": SUMMARY if delivered else NONE},
    }


def sensed(
    protocol: str, broken: dict[tuple[int, str], dict[str, int]] | None = None, **changed: Any
) -> dict[str, Any]:
    """An attempt with 18 series, of which some are broken."""
    found = [
        one_series(drone, kind, **(broken or {}).get((drone, kind), {})) for drone in range(1, 7) for kind in UNITS
    ]
    frames = {"packets": 10, "bytes": 4500}
    traffic = {link: {"sensor": frames, "acknowledgement": frames} for link in ("sense", "air", "backhaul", "wan")}
    delays = {"captures": SUMMARY | {"n": 90}, "app": SUMMARY | {"n": 90}}
    told = {"series": found, "reading_delay_ms": delays, "reading_traffic": traffic, "out_of_range": 0}
    return entry(protocol, **(told | changed))


def both(series: Series, **of_mavlink: Any) -> dict[str, Any]:
    sides = (("mqttxt", sensed("mqttxt")), ("mavlink", sensed("mavlink", **of_mavlink)))
    return make_series(series, *sides, experiment="scenario-4")


def test_every_series_has_a_row_with_both_sides(series: Series) -> None:
    page = page_of(series, both(series))
    rows = {row[0]: row[1:] for row in page.rows if row and row[0].startswith("drone ")}
    assert rows["drone 2, temperature in °C"] == ["✓ 5 of 5", "5.00 ms", "7.00 ms", "5.00 ms"] * 2
    assert sum(" in °C" in name or " in %" in name or " in lx" in name for name in rows) == 18
    assert "MQTT-XT: all 18 series arrived whole, as they were measured." in page.sections["sensors"]


def test_what_is_missing_is_named_by_drone(series: Series) -> None:
    never = {(3, kind): {"measured": 0, "delivered": 0} for kind in UNITS}
    broken = never | {(5, "light"): {"delivered": 3, "wrong": 1}}
    metrics = both(series, broken=broken, status="failed", reason="collect: not done within 65 s", mission_s=None)
    assert readings.said(metrics) == [
        "MQTT-XT: all 18 series arrived whole, as they were measured.",
        "MAVLink: not every series arrived whole.",
        "MAVLink, attempt 1: drone 3: its sensor 3 was never reached and measured nothing; drone 5: light 3 of 5, "
        "1 wrong.",
    ]
    page = page_of(series, metrics)
    assert "was never reached and measured nothing" in page.sections["sensors"]
    rows = {row[0]: row[1:] for row in page.rows if row}
    assert rows["drone 3, humidity in %"][4] == "0 of 5, 0 measured"
    assert rows["drone 5, light in lx"][4] == "3 of 5, 1 wrong"
    assert "drone 5: light 3 of 5, 1 wrong." in terminal_of(series, metrics)


def test_several_attempts_say_in_how_many_all_arrived(series: Series) -> None:
    broken = {(1, "light"): {"delivered": 4}}
    flown = [("mqttxt", sensed("mqttxt", number=n, broken=broken if n == 2 else None)) for n in (1, 2, 3)]
    metrics = make_series(series, *flown, experiment="scenario-4")
    assert readings.said(metrics) == [
        "MQTT-XT: not every series arrived whole, in 2 of 3 attempts they did.",
        "MQTT-XT, attempt 2: drone 1: light 4 of 5.",
    ]


def test_what_carrying_took_is_summed_over_the_links_and_told_for_each_value(series: Series) -> None:
    shown = comparison.shown(both(series))
    table = readings.traffic_of(shown)
    assert [link for link, _ in table] == ["sense", "air", "backhaul", "wan", "all links"]
    assert table[-1][1]["mqttxt"] == [{"packets": 40, "bytes": 18000}] * 2 + [{"packets": 0, "bytes": 0}]
    assert readings.cost(shown) == (
        "A value that arrived took 200 bytes over MQTT-XT and 200 bytes over the plain brokers beside MAVLink, "
        "on all four links together."
    )


def test_without_sensors_there_is_nothing_of_them(series: Series) -> None:
    metrics = make_series(series, ("mqttxt", entry("mqttxt")), ("mavlink", entry("mavlink")))
    page = page_of(series, metrics)
    assert not {"sensors", "readings", "reading-delay", "reading-traffic"} & set(page.sections)
    assert readings.said(metrics) == []


def test_frames_that_found_a_sensors_link_closed_are_not_among_the_lost(series: Series) -> None:
    links = {"sense:uav1:up": {"packets": 300, "bytes": 30_000, "lost": 200}}
    links |= {f"backhaul:fog{fog}:up": {"packets": 0, "bytes": 0, "lost": 0} for fog in (1, 2)}
    one = sensed("mqttxt", links=links, out_of_range=200)
    metrics = make_series(series, ("mqttxt", one), experiment="scenario-4")
    lost = comparison.rows(metrics)["wire_loss"].cells["mqttxt"]
    assert (lost.text, lost.brief, lost.counts) == ("0 of 1,500 (< 0.2 %)", "0 (< 0.2 %)", "0 of 1,500")
    assert metrics["statistics"]["losses"]["frames"]["mqttxt"] == {"sent": 1500, "lost": 0, "share": 0, "below": 0.002}
    (packets,) = [row for row in thesis_rows.rows(metrics) if row.name == "packets lost"]
    assert packets.cells["mqttxt"].here == "0"


@pytest.mark.parametrize("experiment", ["scenario-1", "scenario-2", "scenario-3", "scenario-4"])
def test_each_scenario_has_the_thesiss_figures_and_its_caveats_beside(tmp_path: Path, experiment: str) -> None:
    series = new_series(tmp_path, experiment, "thesis", "ideal")
    metrics = make_series(series, ("mqttxt", entry("mqttxt")), ("mavlink", entry("mavlink")), experiment=experiment)
    page = page_of(series, metrics)
    printed = thesis.of_scenario(experiment)
    assert any(f"{printed['packets']['mavlink']:,.0f}" in row for row in page.rows)
    for caveat in thesis.caveats(experiment):
        assert caveat in page.sections["thesis"]
    assert "scenarios" in page.sections


@pytest.mark.parametrize("fogs", [1, 2, 3])
@pytest.mark.parametrize("drones", [6, 9])
def test_only_a_fleet_of_its_size_has_the_thesiss_figures_beside_it(series: Series, fogs: int, drones: int) -> None:
    one = entry("mqttxt")
    words, share = one["outcomes"]["1"], one["links"]["wan:gs:up"]
    other = {
        "outcomes": {str(drone): words for drone in range(1, drones + 1)},
        "links": {"wan:gs:up": share, **{f"backhaul:fog{fog}:up": share for fog in range(1, fogs + 1)}},
    }
    metrics = make_series(series, ("mqttxt", entry("mqttxt", **other)), ("mavlink", entry("mavlink", **other)))
    page = page_of(series, metrics)
    alike = (fogs, drones) == (2, 6)
    assert bool(thesis_rows.rows(metrics)) is alike
    assert {"thesis", "scenarios"} & set(page.sections) == ({"thesis", "scenarios"} if alike else set())


def test_a_printed_size_that_is_a_slip_makes_no_ratio_of_the_thesis(series: Series) -> None:
    rows = {row.name: row for row in thesis_rows.rows(both(series))}
    size, packets = rows["bytes"].ratio, rows["packets"].ratio
    assert size is not None
    assert packets is not None
    assert (size.thesis, packets.thesis) == ("–", "42×")
    assert rows["bytes"].cells["mqttxt"].thesis == "348 kB"


def measured(drone: int, kind: str, second: int, told_ms: float | None = 8.0) -> MeasuredValue:
    time_ms = START_NS // 1_000_000 + 1000 * second
    left_ns = time_ms * 1_000_000 + 1_000_000
    told_ns = None if told_ms is None else time_ms * 1_000_000 + round(told_ms * 1e6)
    arrived_ns = None if told_ms is None else left_ns + 4_000_000
    return MeasuredValue(drone, drone, kind, UNITS[kind], 20.0 + second, time_ms, left_ns, arrived_ns, told_ns)


def test_the_figures_data_has_each_value_with_its_times() -> None:
    values = (measured(1, "light", 12), measured(1, "temperature", 12), measured(2, "light", 13, told_ms=None))
    figure = figures.values({"mqttxt": figures.DetailedReadings(values, START_NS)})
    assert figure is not None
    assert figure.csv().splitlines()[1:] == [
        "mqttxt,1,1,light,lx,12,32,12.008,4,8",
        "mqttxt,1,1,temperature,degC,12,32,12.008,4,8",
        "mqttxt,2,2,light,lx,13,33,,,",
    ]
    assert "arrived: 2 of 3 over MQTT-XT" in figure.shows
    drawn = figure.wide()
    assert drawn.index("temperature, °C") < drawn.index("light, lx")
    assert drawn.count('class="h-bad"') == 1, "what never came is hollow and red"
    assert "drone 2: 33 lx, measured at 13.0 s, never came" in drawn


def test_of_many_values_only_what_never_came_is_marked() -> None:
    values = tuple(measured(1, "light", second, told_ms=None if second == 7 else 8.0) for second in range(100))
    figure = figures.values({"mavlink": figures.DetailedReadings(values, START_NS)})
    assert figure is not None
    assert figure.wide().count("<title>MAVLink, drone 1") == 1
    assert "measured at 7.0 s, never came" in figure.wide()
    assert len(figure.rows) == 100


def test_delays_are_shown_both_ways() -> None:
    values = (measured(1, "light", 12), measured(2, "light", 13, told_ms=60.0))
    figure = figures.delays({"mavlink": figures.DetailedReadings(values, START_NS)})
    assert figure is not None
    assert [row[2:] for row in figure.rows] == [(4.0, 0.5), (4.0, 1.0), (8.0, 0.5), (60.0, 1.0)]
    assert "node to node" in figure.narrow()


def test_nothing_measured_draws_nothing() -> None:
    assert figures.values({"mqttxt": figures.DetailedReadings((), START_NS)}) is None
    assert (
        figures.delays({"mqttxt": figures.DetailedReadings((measured(1, "light", 1, told_ms=None),), START_NS)}) is None
    )
