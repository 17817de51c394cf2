"""A gate is open while its drone is near, by the position that was last written."""

from __future__ import annotations

from pathlib import Path

import pytest

from net.interfaces import NetError
from net.link_plan import Gate
from net.shaping.gates import distance_m, is_open, position_file, read_position

GATE = Gate("sense:uav1", 1, 47.397742, 8.545594, 50.0)
DEGREE_M = 111_195.08
"""Of latitude, on a sphere of the Earth's mean radius."""


def test_distances_are_along_the_ground() -> None:
    assert distance_m(10.0, 20.0, 11.0, 20.0) == pytest.approx(DEGREE_M, rel=1e-6)
    assert distance_m(0.0, 179.5, 0.0, -179.5) == pytest.approx(DEGREE_M, rel=1e-6)
    assert distance_m(60.0, 20.0, 60.0, 20.001) == pytest.approx(DEGREE_M / 2000, rel=1e-6)
    assert distance_m(1.0, 2.0, 1.0, 2.0) == 0.0


@pytest.mark.parametrize(("metres", "expected"), [(0.0, True), (49.9, True), (50.1, False)])
def test_a_gate_is_open_up_to_its_range(metres: float, expected: bool) -> None:
    assert is_open(GATE, (GATE.latitude_deg + metres / DEGREE_M, GATE.longitude_deg)) is expected


def test_a_drone_of_which_nothing_is_known_is_out_of_range(tmp_path: Path) -> None:
    assert read_position(position_file(tmp_path, 1)) is None
    assert not is_open(GATE, None)


def test_a_position_is_what_the_autopilot_wrote_last(tmp_path: Path) -> None:
    path = position_file(tmp_path, 3)
    assert path == tmp_path / "sitl" / "uav3.position.json"
    path.parent.mkdir()
    path.write_text('{"t_ns": 1, "latitude_deg": 47, "longitude_deg": 8.5, "altitude_m": 3.0}\n')
    assert read_position(path) == (47.0, 8.5)


@pytest.mark.parametrize("text", ["", "[]", '{"latitude_deg": 1}', '{"latitude_deg": "1", "longitude_deg": 2}'])
def test_a_position_that_makes_no_sense_is_an_error(tmp_path: Path, text: str) -> None:
    path = tmp_path / "uav1.position.json"
    path.write_text(text)
    with pytest.raises(NetError) as error:
        read_position(path)
    assert str(path) in str(error.value)
