"""Flights of fleets of different sizes: what is read from a series, its table and its picture."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from spec import flights
from spec.flights import flight, flights_table
from testbed.errors import ResultsError


def entry(drones: int = 2, seconds: int = 10) -> dict[str, Any]:
    """An attempt at two fogs: 100 bytes per second of each drone, 50 to the station, the first and last second wild."""
    load = [9_000, *[100] * (seconds - 2), 3]
    fogs = {f"fog{fog}": {f"uav{fog}{drone}": load for drone in range(drones // 2)} for fog in (1, 2)}
    total = [9_000 * drones, *[100 * drones] * (seconds - 2), 3 * drones]
    return {
        "attempt": 1,
        "status": "completed",
        "load": {**fogs, "total": total},
        "traffic": {"wan": [7_000, *[50] * (seconds - 2), 1]},
        "delay_ms": {"arm": [1.0, 2.0], "land": [9.0]},
        "cpu_s": {"activator1": 1.5, "activator2": 0.5, "broker": 0.4, "client1": 7.0, "fog1": 3.0},
    }


def test_loads_are_means_without_both_ends_and_processor_time_is_that_of_what_passes_on() -> None:
    one = flight("mqttxt", entry())
    assert (one.fogs, one.drones, one.of_fog, one.total, one.wan) == (2, 2, 100, 200, 50)
    assert (one.fog_s, one.cloud_s, one.delay_ms, one.slowest_ms) == (2.0, 0.4, 2.0, 9.0)


@pytest.mark.parametrize("changed", [{"delay_ms": {}}, {"load": {"fog1": {}, "total": [1, 2, 3, 4]}}])
def test_an_attempt_without_commands_or_of_a_few_seconds_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(ResultsError, match="attempt 1: expected a mission with commands"):
        flight("mqttxt", entry() | changed)


def test_series_become_rows_by_fleet_with_mqttxt_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flights, "FLIGHTS", tmp_path / "flights.json")
    for drones in (4, 2):
        (tmp_path / str(drones)).mkdir()
        both = {protocol: {"attempts": [entry(drones)]} for protocol in ("mavlink", "mqttxt")}
        (tmp_path / str(drones) / "metrics.json").write_text(json.dumps({"protocols": both}))
    flights.main(str(tmp_path / "4"), str(tmp_path / "2"))
    found = flights.read_flights(tmp_path / "flights.json")
    assert [(one.drones, one.protocol) for one in found] == [
        (2, "mavlink"),
        (2, "mqttxt"),
        (4, "mavlink"),
        (4, "mqttxt"),
    ]
    rows = flights_table(found).splitlines()[2:]
    assert [row.split(" | ")[:4] for row in rows] == [
        ["| 2 at 2", "completed / completed", "0.8 / 0.8", "1.6 / 1.6"],
        ["| 4 at 2", "completed / completed", "1.6 / 1.6", "3.2 / 3.2"],
    ]
