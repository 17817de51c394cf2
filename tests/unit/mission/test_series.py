"""Series that arrived, held to what was measured: a value, a unit or a time that is another one is no delivery."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from mission.fleet import Reading
from mission.series import KINDS, ReadingSeries, compare, has_measured, read_measured, write

FIRST = Reading(drone=2, sensor=2, boot=9, seq=0, kind="light", value=120.0, unit="lx", time_ms=1000)
SECOND = replace(FIRST, seq=3, value=121.0, time_ms=2000)


def _light(measured: list[Reading], arrived: list[Reading], samples: int = 2) -> ReadingSeries:
    return {series.kind: series for series in compare((2,), measured, arrived, samples)}["light"]


def test_a_series_is_whole_when_all_arrived_as_measured() -> None:
    found = _light([FIRST, SECOND], [SECOND, FIRST])
    assert found.is_whole
    assert (found.measured, found.delivered, found.wrong) == (2, 2, 0)


@pytest.mark.parametrize(
    "other",
    [
        replace(SECOND, value=121.5),
        replace(SECOND, unit="klx"),
        replace(SECOND, time_ms=2001),
        replace(SECOND, boot=8),
    ],
)
def test_a_value_that_arrives_otherwise_is_wrong(other: Reading) -> None:
    found = _light([FIRST, SECOND], [FIRST, other])
    assert (found.delivered, found.wrong, found.is_whole) == (1, 1, False)
    assert str(found) == "sensor 2 light: 1 of 2 values as measured, 1 wrong"


def test_a_value_that_does_not_arrive_is_missing() -> None:
    found = _light([FIRST, SECOND], [FIRST])
    assert str(found) == "sensor 2 light: 1 of 2 values as measured"
    assert not found.is_whole


def test_a_sensor_that_measured_less_than_it_should_makes_no_whole_series() -> None:
    assert not _light([FIRST], [FIRST]).is_whole


def test_there_is_a_series_of_each_kind_from_each_drones_sensor_even_if_nothing_came() -> None:
    found = compare(range(1, 7), [], [], 30)
    assert len(found) == 18
    assert {(one.drone, one.sensor, one.kind) for one in found} == {(n, n, kind) for n in range(1, 7) for kind in KINDS}
    assert {one.unit for one in found} == {"degC", "%", "lx"}


def test_what_another_drone_brought_is_wrong() -> None:
    stolen = replace(FIRST, drone=1)
    of_one, of_two = (
        {series.kind: series for series in compare((drone,), [FIRST], [stolen], 1)}["light"] for drone in (1, 2)
    )
    assert (of_two.delivered, of_two.wrong) == (0, 0)
    assert not of_one.is_whole


def test_sensors_records_are_read_and_the_result_is_written(tmp_path: Path) -> None:
    lines = [{"event": "reading", "sensor": 2, "boot": 9, "seq": seq, "kind": "light"} for seq in (0, 3)]
    told = [
        lines[0] | {"value": 120.0, "unit": "lx", "time_ms": 1000},
        lines[1] | {"value": 121.0, "unit": "lx", "time_ms": 2000},
    ]
    told.append(told[1] | {"event": "dropped"})
    (tmp_path / "sensor2.jsonl").write_text("".join(json.dumps(line) + "\n" for line in told))
    measured = list(read_measured(tmp_path, (1, 2)))
    assert [has_measured(tmp_path, drone) for drone in (1, 2)] == [False, True]
    assert measured == [FIRST, SECOND]
    write(compare((2,), measured, measured, 2), tmp_path / "series.json")
    written = json.loads((tmp_path / "series.json").read_text())
    assert written["version"] == 1
    assert written["series"][2] == {
        **{"drone": 2, "sensor": 2, "kind": "light", "unit": "lx"},
        **{"samples": 2, "measured": 2, "delivered": 2, "wrong": 0, "whole": True},
    }
