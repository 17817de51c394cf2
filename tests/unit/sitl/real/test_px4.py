"""What a PX4 is given before its start, by what its own build says of its parameters; no PX4 runs."""

from __future__ import annotations

import json
import lzma
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from sitl.dynamics import Place
from sitl.errors import SitlError
from sitl.fleet import DroneConfig
from sitl.process import LinkConfig
from sitl.px4.streams import SETS
from sitl.real.px4 import MOST_FACTOR, OWN, PARAMETERS, STEPS, STREAMS, Px4, scheduled, speed_factor

ALIASES = """alias set=_set
alias commander='px4-commander --instance $px4_instance'
alias param='px4-param --instance $px4_instance'
"""
CONFIG = DroneConfig(3, Place(47.398102, 8.545594, 488.5), parameters={"MPC_XY_CRUISE": 14.0, "NAV_DLL_ACT": 0})


def make_folder(path: Path, home: dict[str, str], without: str = "") -> Path:
    """A PX4's folder as a copy has it that lost its links; `home` is how it has latitude and longitude."""
    whole = ["COM_RC_IN_MODE", "NAV_DLL_ACT", "SDLOG_MODE", "SDLOG_PROFILE", "MAV_SYS_ID"]
    known: list[dict[str, Any]] = [{"name": name, "type": "Int32", "units": None} for name in whole]
    known += [{"name": f"SIH_LOC_{axis}0", **home} for axis in ("LAT", "LON")]
    known += [{"name": name, "type": "Float"} for name in ("SIH_LOC_H0", "MPC_XY_CRUISE")]
    (path / PARAMETERS).parent.mkdir(parents=True)
    found = {"parameters": [entry for entry in known if entry["name"] != without]}
    (path / PARAMETERS).write_bytes(lzma.compress(json.dumps(found).encode()))
    (path / "bin").mkdir()
    (path / "bin" / "px4").write_text("the program")
    (path / "bin" / "px4-param").write_text("px4")
    (path / "bin" / "px4-alias.sh").write_text(ALIASES)
    return path


def prepared(
    tmp_path: Path, home: dict[str, str], streams: str = "px4-onboard"
) -> tuple[Px4, list[str], dict[str, str]]:
    folder = make_folder(tmp_path / "given", home)
    link = LinkConfig(("127.0.0.1", 14583), ("198.18.0.3", 14543), streams)
    px4 = Px4(folder, tmp_path / "work", tmp_path / "logs", CONFIG, link, 14550)
    return (px4, *px4.prepare())


OLD, NEW = {"type": "Int32", "units": "deg*1e7"}, {"type": "Float", "units": "deg"}


@pytest.mark.long
@pytest.mark.parametrize(("home", "latitude"), [(OLD, "473981020"), (NEW, "47.3981020")])
def test_both_ways_to_set_parameters_get_all_in_the_units_that_this_px4_has(
    tmp_path: Path, home: dict[str, str], latitude: str
) -> None:
    _, _, environment = prepared(tmp_path, home)
    hook = (tmp_path / "work" / "hooks" / "px4-rc.params").read_text().splitlines()
    by_hook = dict(line.removeprefix("param set ").split() for line in hook)
    by_environment = {n.removeprefix("PX4_PARAM_"): v for n, v in environment.items() if n.startswith("PX4_PARAM_")}
    assert by_hook == by_environment
    assert by_hook["SIH_LOC_LAT0"] == latitude
    assert (by_hook["MAV_SYS_ID"], by_hook["MPC_XY_CRUISE"]) == ("3", "14.0000000")
    assert {name: float(by_hook[name]) for name in OWN} == OWN


def test_drones_of_a_fleet_take_the_processors_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {5, 2})
    assert [scheduled(number)[:3] for number in (1, 2, 3)] == [["taskset", "--cpu-list", each] for each in "525"]


@pytest.mark.long
def test_it_is_started_in_a_folder_of_its_own_with_all_its_commands(tmp_path: Path) -> None:
    _, words, environment = prepared(tmp_path, NEW)
    work = tmp_path / "work"
    assert words == [
        *scheduled(3),
        f"{work}/bin/px4",
        *("-d", "-i", "3", "-w"),
        str(work),
        f"{tmp_path}/given/etc",
    ]
    assert environment["PATH"].startswith(f"{work}/hooks:")
    assert {path.name for path in (work / "bin").iterdir()} == {"px4", "px4-alias.sh", "px4-commander", "px4-param"}
    assert (work / "bin" / "px4-param").read_text() == "the program"
    assert (work / "log").resolve() == (tmp_path / "logs").resolve()


@pytest.mark.long
@pytest.mark.parametrize("streams", SETS)
def test_it_has_a_link_to_who_flies_it_and_one_for_its_witness(tmp_path: Path, streams: str) -> None:
    prepared(tmp_path, NEW, streams)
    lines = (tmp_path / "work" / "hooks" / "px4-rc.mavlink").read_text().splitlines()
    mode = {"px4-onboard": "onboard", "px4-gcs": "normal", "px4-normal": "normal", "five-states": "custom"}[streams]
    assert lines[0] == f"mavlink start -x -u 14583 -r 4000000 -f -m {mode} -o 14543 -t 198.18.0.3"
    assert sum(line.startswith("mavlink stream -u 14583 ") for line in lines) == len(STREAMS[streams][1])
    assert lines[-2:] == [
        "mavlink start -x -u 18573 -r 4000000 -m custom -o 14550",
        "mavlink stream -u 18573 -s HEARTBEAT -r 50",
    ]


@pytest.mark.parametrize(("takes_s", "factor"), [(0.0043, 1.075), (0.004, 1.0), (0.003, 1.0), (0.04, MOST_FACTOR)])
def test_its_simulator_is_sped_up_by_what_a_sleep_takes_longer_here(takes_s: float, factor: float) -> None:
    slept: list[float] = []
    assert speed_factor(lambda _: slept.append(takes_s), lambda: sum(slept)) == pytest.approx(factor)
    assert len(slept) == STEPS


@pytest.mark.long
def test_what_is_read_back_has_to_be_what_was_set(tmp_path: Path) -> None:
    px4, _, environment = prepared(tmp_path, NEW)
    answers = {name: environment[f"PX4_PARAM_{name}"] for name in px4.questions()}
    px4.check(answers)
    px4.check(answers | {"SIH_LOC_LAT0": "47.3981"})
    with pytest.raises(SitlError, match=r"PX4's MPC_XY_CRUISE is 5\.0000; expected 14\.0000000"):
        px4.check(answers | {"MPC_XY_CRUISE": "5.0000"})
    with pytest.raises(SitlError, match="PX4's MAV_SYS_ID is not told; expected 3"):
        px4.check(answers | {"MAV_SYS_ID": ""})


def test_a_parameter_that_this_px4_does_not_have_is_one_line(tmp_path: Path) -> None:
    link = LinkConfig(("127.0.0.1", 14583), ("127.0.0.1", 14543), "px4-onboard")
    px4 = Px4(tmp_path / "given", tmp_path / "work", tmp_path / "logs", CONFIG, link, 14550)
    with pytest.raises(SitlError, match=r"parameters\.json\.xz: No such file"):
        px4.prepare()
    make_folder(tmp_path / "given", NEW, without="MPC_XY_CRUISE")
    with pytest.raises(SitlError, match=r"no MPC_XY_CRUISE; expected a PX4 that has it"):
        px4.prepare()
    (tmp_path / "given" / PARAMETERS).write_bytes(b"no archive")
    with pytest.raises(SitlError, match="expected what PX4's build says of its parameters"):
        replace(px4).prepare()
