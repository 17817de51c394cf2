"""Where the drones are sent: each to a point of its own, out of reach of the sensor there when it takes off."""

from __future__ import annotations

from pathlib import Path

import pytest

from mission.fleet import Point
from mission.points import all_points, points_of
from mqttxt.protocol.commands import haversine_m
from sitl.fleet import load

FLEET = Path(__file__).parents[3] / "services" / "fleet.yaml"
RANGE_M = 50


def test_a_point_is_60_to_120_m_from_where_its_drone_takes_off() -> None:
    for drone, point in all_points().items():
        home = load(FLEET, drone).home
        away_m = haversine_m(home.latitude_deg, home.longitude_deg, point.latitude_deg, point.longitude_deg)
        assert 60 <= away_m <= 120.5, drone
        assert away_m > RANGE_M


def test_the_points_of_another_fleet_are_those_of_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text("drones: {7: {point: {latitude_deg: 47, longitude_deg: 8, altitude_m: 12}}}\n")
    monkeypatch.setenv("FLEET_FILE", str(path))
    all_points.cache_clear()
    try:
        assert points_of([7]) == {7: Point(47, 8, 12)}
    finally:
        all_points.cache_clear()


def test_a_drone_without_a_point_is_named() -> None:
    assert list(points_of((2, 5))) == [2, 5]
    said = r"^drone 7 has no point in the fleet's file: expected drones of 1, 2, 3, 4, 5, 6$"
    with pytest.raises(ValueError, match=said):
        points_of((1, 7))
