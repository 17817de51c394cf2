"""What an ArduCopter is given before its start; none runs."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from sitl.dynamics import Place
from sitl.errors import SitlError
from sitl.fleet import DroneConfig, load
from sitl.process import LinkConfig
from sitl.real.ardupilot import ArduCopter

FLEET = Path(__file__).resolve().parents[4] / "services" / "fleet.yaml"
CONFIG = DroneConfig(3, Place(47.398102, 8.545594, 488.5), parameters={"MPC_XY_CRUISE": 14.0, "RTL_RETURN_ALT": 10.0})


@pytest.fixture
def copter(tmp_path: Path) -> ArduCopter:
    link = LinkConfig(("127.0.0.1", 14583), ("198.18.0.3", 14543), "px4-onboard")
    return ArduCopter(tmp_path / "given", tmp_path / "work", tmp_path / "logs", CONFIG, link, 14550)


def test_it_has_its_place_and_number_a_link_to_who_flies_it_and_one_for_its_witness(copter: ArduCopter) -> None:
    words, _ = copter.prepare()
    assert words[0] == str(copter.folder / "arducopter")
    options = dict(pairwise(words))
    assert (options["--sysid"], options["--instance"], options["--model"]) == ("3", "3", "quad")
    assert options["--home"] == "47.3981020,8.5455940,488.50,0"
    assert (options["--serial0"], options["--serial1"]) == ("udpclient:198.18.0.3:14543", "udpclient:127.0.0.1:14550")
    assert options["--defaults"] == f"{copter.folder}/copter.parm,{copter.work}/fleet.parm"
    assert "--wipe" in words


def test_the_fleets_parameters_are_told_by_its_own_names_and_in_its_own_units(copter: ArduCopter) -> None:
    copter.prepare()
    told = dict(line.split() for line in (copter.work / "fleet.parm").read_text().splitlines())
    assert told == {"FLTMODE_CH": "0", "INITIAL_MODE": "4", "WPNAV_SPEED": "1400", "RTL_ALT": "1000"}


@pytest.mark.parametrize("drone", range(1, 7))
def test_every_drone_of_the_fleet_can_be_one(copter: ArduCopter, drone: int) -> None:
    words, _ = replace(copter, config=load(FLEET, drone)).prepare()
    assert words[words.index("--sysid") + 1] == str(drone)


def test_a_parameter_without_a_counterpart_is_one_line(copter: ArduCopter) -> None:
    wrong = replace(copter, config=replace(CONFIG, parameters={"NAV_ACC_RAD": 5.0}))
    with pytest.raises(SitlError, match=r"drones\.3\.parameters\.NAV_ACC_RAD: ArduCopter has no such parameter"):
        wrong.prepare()


def test_its_log_is_kept_where_it_was_asked_for(copter: ArduCopter) -> None:
    copter.prepare()
    assert (copter.work / "logs").resolve() == copter.logs.resolve()
    copter.prepare()
