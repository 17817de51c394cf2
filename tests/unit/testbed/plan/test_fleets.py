"""Fleets of files and of any size; what is wrong with one is a line that names file, field, value and expectation."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from mqttxt.protocol.commands import haversine_m
from testbed.cli import commands as cli
from testbed.errors import UserError
from testbed.plan.experiments import make_plan
from testbed.plan.fleets import FLEET_FILE, fleet_of, read_fleet, standard_fleet, suffix


def test_nothing_asks_for_another_fleet() -> None:
    assert fleet_of({"FOGS": "", "DRONES": "", "FLEET": "", "HOME": "/"}) is standard_fleet()
    assert fleet_of({"FOGS": "2", "DRONES": "6"}) == standard_fleet()
    assert suffix({"FOGS": "2", "DRONES": "6"}) == ""


@pytest.mark.parametrize(
    ("asked", "flown"),
    [
        ({"FOGS": "3", "DRONES": "12"}, "1:1,2,3,4;2:5,6,7,8;3:9,10,11,12"),
        ({"FOGS": "1", "DRONES": "2"}, "1:1,2"),
        ({"FOGS": "4"}, "1:1,2;2:3,4;3:5;4:6"),
        ({"DRONES": "7"}, "1:1,2,3,4;2:5,6,7"),
        ({"DRONES": "1"}, "1:1"),
    ],
)
def test_drones_are_spread_over_the_fogs_evenly(asked: dict[str, str], flown: str) -> None:
    assert fleet_of(asked).flown == flown


def test_the_results_path_has_another_fleets_size_and_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(_document() | {"fogs": {1: [1]}}))
    assert suffix({"FOGS": "3", "DRONES": "9"}) == "+fogs-3+drones-9"
    assert suffix({"FLEET": str(path)}) == "+fleet-mine+fogs-1+drones-1"


def test_a_further_drone_is_like_one_of_the_file_in_a_place_of_its_own() -> None:
    fleet = fleet_of({"FOGS": "5", "DRONES": "40"})
    assert fleet.drones[6] == standard_fleet().drones[6]
    for name in ("capacity_wh", "charge_pct", "endurance_s", "parameters"):
        assert fleet.drones[7][name] == standard_fleet().drones[1][name]
    for one, other in combinations(fleet.drones.values(), 2):
        assert _apart_m(one, other) > 20
        assert _apart_m(one["point"], other["point"]) > 2 * fleet.sensor_range_m
    for drone in fleet.drones.values():
        assert fleet.sensor_range_m < _apart_m(drone, drone["point"]) <= 120.5


def _apart_m(one: Any, other: Any) -> float:
    return haversine_m(one["latitude_deg"], one["longitude_deg"], other["latitude_deg"], other["longitude_deg"])


def test_a_fleet_that_was_written_down_is_read_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(yaml.safe_dump(_document() | {"fogs": {2: [5, 3]}}))
    for fleet in (fleet_of({"FOGS": "3", "DRONES": "7"}), read_fleet(path)):
        path.write_text(yaml.safe_dump(fleet.to_data()))
        assert read_fleet(path) == fleet


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"FOGS": "2", "DRONES": "1"}, "FOGS=2: expected a whole number from 1 to 1 and no more fogs than drones"),
        ({"DRONES": "0"}, "DRONES=0: expected a whole number from 1 to 250"),
        ({"FOGS": "0"}, "FOGS=0: expected a whole number from 1 to 6 and no more fogs than drones"),
        ({"FOGS": "7"}, "FOGS=7: expected a whole number from 1 to 6 and no more fogs than drones"),
        ({"DRONES": "many"}, "DRONES=many: expected a whole number from 1 to 250"),
        ({"DRONES": "251"}, "DRONES=251: expected a whole number from 1 to 250"),
        (
            {"FOGS": "11", "DRONES": "22"},
            "FOGS=11 DRONES=22: uav1 would be in 198.18.21.0/24, which is fog11's: "
            "expected fewer, or other addresses in a file (FLEET)",
        ),
    ],
)
def test_a_size_that_cannot_be_is_one_line(asked: dict[str, str], said: str) -> None:
    with pytest.raises(UserError) as error:
        fleet_of(asked)
    assert str(error.value) == said


def test_a_wrong_size_ends_the_command_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRONES", "300")
    result = CliRunner().invoke(cli.app, ["run", "scenario-1", "--results", str(tmp_path / "results")])
    assert result.exit_code == 2
    assert result.stderr == "testbed: DRONES=300: expected a whole number from 1 to 250\n"
    assert not (tmp_path / "results").exists()


@pytest.mark.long
def test_ten_fogs_and_every_drone_that_mavlink_has_an_id_for_have_addresses() -> None:
    fleet = fleet_of({"FOGS": "10", "DRONES": "250"})
    assert (fleet.address("fog10"), fleet.address("uav250")) == ("198.18.20.3", "198.19.14.3")
    assert fleet.address("sensor250") == "198.19.145.131"


def test_mavlink_has_system_ids_for_48_drones_and_their_routers() -> None:
    fleet = fleet_of({"DRONES": "49"})
    assert make_plan("scenario-1", protocols="mqttxt", fleet=fleet).fleet == fleet
    with pytest.raises(UserError, match="drone 49 of the fleet: expected drones 1 to 48 over MAVLink"):
        make_plan("scenario-1", fleet=fleet)


def _document() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(FLEET_FILE.read_text())
    return found


def _changed(*path: Any, to: Any = None) -> dict[str, Any]:
    """The experiments' file with one field that is another, or gone."""
    document = _document()
    inner = document
    for part in path[:-1]:
        inner = inner[part]
    if to is None:
        del inner[path[-1]]
    else:
        inner[path[-1]] = to
    return document


@pytest.mark.parametrize(
    ("document", "said"),
    [
        (_changed("wind", to=3), "wind: 3: unknown field: expected one of fogs, addresses, sensor_range_m, "),
        (_changed("fogs"), "fogs: missing: expected the drones of each fog, as 1: [1, 2, 3]"),
        (_changed("fogs", to={}), "fogs: {}: expected the drones of each fog"),
        (_changed("fogs", 1, to=[]), "fogs.1: []: expected a list of drones, as [1, 2, 3]"),
        (_changed("fogs", 1, to=[251]), "fogs.1[0]: 251: expected a drone's number from 1 to 250"),
        (_changed("fogs", 251, to=[1]), "fogs: '251': expected a number from 1 to 250"),
        (_changed("fogs", 1, to=[1, 4]), "fogs: drone 4 is there 2 times: expected each drone once"),
        (_changed("drones", 5), "drones.5: missing: expected an entry for each drone of a fog"),
        (_changed("drones", 5, "latitude_deg", to="north"), "drones.5.latitude_deg: 'north': expected degrees from"),
        (_changed("drones", 5, "point"), "drones.5.point: missing: expected a place: latitude_deg, longitude_deg and"),
        (_changed("drones", 5, "latitude_deg", to=float("nan")), "drones.5.latitude_deg: '.nan': expected degrees"),
        (
            _changed("parameters", to={"MPC_SPEED": 3}),
            "parameters.MPC_SPEED: 3: unknown parameter: expected one of BAT",
        ),
        (
            _changed("drones", 5, "parameters", "MPC_XY_CRUISE", to=99),
            "drones.5.parameters.MPC_XY_CRUISE: 99: expected 0.5 to 20",
        ),
        (_changed("drones", 5, "endurance_s", to=0.5), "drones.5.endurance_s: 0.5: expected whole seconds from 1"),
        (
            _changed("addresses", "gs", to="10.0.0.0/24"),
            "addresses.gs: '10.0.0.0/24': expected a network within 198.18",
        ),
        (_changed("addresses", "gs", to="198.18.0.1/24"), "addresses.gs: '198.18.0.1/24': expected a network ("),
        (_changed("addresses", "gs", to="198.18.0.0/24\n"), r"addresses.gs: '198.18.0.0/24\n': expected a network ("),
        (
            _changed("addresses", "fogs", to="198.19.254.128/25") | {"fogs": {9: [1]}},
            "addresses: fog9 would be in 198.20.2.128/25, which is outside of 198.18.0.0/15: expected another one",
        ),
        (
            _changed("addresses", "drones", to="198.18.12.0/24"),
            "addresses: uav1 would be in 198.18.12.0/24, which is fog2's: expected another one for it",
        ),
        (
            _changed("addresses", "sensors", to="198.19.254.0/24"),
            "addresses: sensor2 would be in 198.19.255.0/24, which is kept free: expected another one for it",
        ),
    ],
)
def test_a_mistake_in_a_file_is_one_line(tmp_path: Path, document: dict[str, Any], said: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(UserError) as error:
        read_fleet(path)
    assert str(error.value).startswith(f"{path}: {said}")
    assert "\n" not in str(error.value)


def test_a_whole_number_with_a_point_is_the_same_number(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(_changed("fogs", 1, to=[1.0, 2, 3])))
    assert read_fleet(path).flown == standard_fleet().flown


@pytest.mark.parametrize("text", ["[", "\udcff", "fogs: {1: [1], 1: [2]}"])
def test_what_is_no_yaml_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(UserError, match=r"mine\.yaml: .*: expected "):
        read_fleet(path)
