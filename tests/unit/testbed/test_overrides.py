"""Which compose files AUTOPILOT and ROUTER lay over compose.yaml, and what they say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from testbed import cli
from testbed.errors import UserError
from testbed.experiments import make_plan
from testbed.flights import settings_of
from testbed.overrides import OVERRIDES, chosen, compose_files, suffix
from testbed.topology import COMPOSE_FILE, ROOT


def test_without_a_variable_nothing_is_laid_over() -> None:
    assert chosen({"AUTOPILOT": "", "HOME": "/"}) == {}
    assert compose_files({}) == [COMPOSE_FILE]


def test_an_autopilot_and_a_router_come_behind_the_compose_file() -> None:
    settings = chosen({"ROUTER": "official", "AUTOPILOT": "px4"})
    assert settings == {"AUTOPILOT": "px4", "ROUTER": "official"}
    assert [path.name for path in compose_files(settings)] == ["compose.yaml", "px4.yaml", "official.yaml"]


def test_a_file_of_ones_own_is_named_by_its_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.yaml").write_text("services: {}\n")
    monkeypatch.chdir(tmp_path)
    assert compose_files(chosen({"AUTOPILOT": "mine.yaml"})) == [COMPOSE_FILE, tmp_path / "mine.yaml"]


def test_a_wrong_autopilot_is_one_line_and_exit_code_2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AUTOPILOT", "px5")
    result = CliRunner().invoke(cli.app, ["run", "scenario-1", "--results", str(tmp_path / "results")])
    assert result.exit_code == 2
    assert result.stderr == "testbed: AUTOPILOT=px5: expected px4, ardupilot, or a compose file of your own\n"
    assert not (tmp_path / "results").exists()


def test_ardupilot_is_for_mavlink_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UserError, match="AUTOPILOT=ardupilot: expected PROTOCOLS=mavlink"):
        chosen({"AUTOPILOT": "ardupilot"}, ("mqttxt", "mavlink"))
    monkeypatch.setenv("AUTOPILOT", "ardupilot")
    assert (
        settings_of(make_plan("scenario-1", "1", "thesis", "ideal", "mavlink", {}), "mavlink")["AUTOPILOT"]
        == "ardupilot"
    )


@pytest.mark.parametrize("name", ["px4", "ardupilot"])
def test_every_drone_has_its_own_home_system_and_witness(name: str) -> None:
    services = _services(OVERRIDES["AUTOPILOT"][name])
    for drone, place in _fleet()["drones"].items():
        home = (place["latitude_deg"], place["longitude_deg"], place["altitude_m"])
        sitl = services[f"sitl{drone}"]
        if name == "px4":
            said = sitl["environment"]
            assert tuple(said[f"PX4_HOME_{what}"] for what in ("LAT", "LON", "ALT")) == home
            assert said["DRONE"] == drone
        else:
            assert f"--home {home[0]},{home[1]},{home[2]},0 " in sitl["command"]
            assert f"--sysid {drone} " in sitl["command"]
        witness = services[f"witness{drone}"]
        assert witness["network_mode"] == f"service:uav{drone}"
        assert f"--system {drone} " in witness["command"]
        assert witness["command"].endswith(f"/run-dir/sitl/uav{drone}.jsonl")


def test_px4_is_given_the_fleets_parameters() -> None:
    fleet, services = _fleet(), _services(OVERRIDES["AUTOPILOT"]["px4"])
    for drone, place in fleet["drones"].items():
        own = {**fleet["parameters"], **place["parameters"]}
        said = services[f"sitl{drone}"]["environment"]
        assert {name: said.get(f"PX4_PARAM_{name}") for name in own} == own


def _services(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(path.read_text())["services"]
    return found


def _fleet() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((ROOT / "services" / "sitl" / "fleet.yaml").read_text())
    return found


def test_the_results_path_names_what_was_laid_over(tmp_path: Path) -> None:
    assert suffix({}) == suffix({"AUTOPILOT": "", "ROUTER": ""}) == ""
    assert suffix({"AUTOPILOT": "px4", "ROUTER": "official"}) == "+autopilot-px4+router-official"
    assert suffix({"AUTOPILOT": str(tmp_path / "mine.yaml")}) == "+autopilot-mine"
