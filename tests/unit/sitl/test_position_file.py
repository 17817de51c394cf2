"""Where a drone is, in a file: replaced as a whole, and moving with the drone."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest

from sitl.errors import SitlError
from sitl.position_file import PositionFile


def test_it_tells_where_the_drone_is_and_when(drone: Any, tmp_path: Path) -> None:
    path = tmp_path / "sitl" / "uav1.position.json"
    file, before_ns = PositionFile(path), time.time_ns()
    file.write(drone.vehicle.position().detail)
    first = json.loads(path.read_text())
    assert before_ns <= first.pop("t_ns") <= time.time_ns()
    home = drone.autopilot.guidance.home
    assert first == {"latitude_deg": home.latitude_deg, "longitude_deg": home.longitude_deg, "altitude_m": 0.0}
    drone.take_off(10)
    file.write(drone.vehicle.position().detail)
    assert json.loads(path.read_text())["altitude_m"] == pytest.approx(10, abs=0.5)


def test_nothing_but_the_whole_file_is_left(drone: Any, tmp_path: Path) -> None:
    file = PositionFile(tmp_path / "uav1.position.json")
    for _ in range(3):
        file.write(drone.vehicle.position().detail)
    assert [path.name for path in tmp_path.iterdir()] == ["uav1.position.json"]


def test_a_place_that_cannot_be_written_is_named(drone: Any) -> None:
    with pytest.raises(SitlError, match=r"^--position-file /proc/x/y\.json: "):
        PositionFile(Path("/proc/x/y.json")).write(drone.vehicle.position().detail)
