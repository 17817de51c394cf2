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
    assert settings == {"AUTOPILOT": "px4", "ROUTER": "official", "AUTOPILOT_IMAGE": "px4io/px4-sitl:v1.17.0"}
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


def test_every_ardupilot_has_its_own_home_system_and_witness() -> None:
    services = _services(OVERRIDES["AUTOPILOT"]["ardupilot"])
    for drone, place in _fleet()["drones"].items():
        sitl, witness = services[f"sitl{drone}"], services[f"witness{drone}"]
        home = f"{place['latitude_deg']},{place['longitude_deg']},{place['altitude_m']}"
        assert f"--home {home},0 " in sitl["command"]
        assert f"--sysid {drone} " in sitl["command"]
        assert witness["network_mode"] == f"service:uav{drone}"
        assert f"--system {drone} " in witness["command"]
        assert f"--events /run-dir/sitl/uav{drone}.jsonl " in witness["command"]
        assert witness["command"].endswith(f"--position-file /run-dir/sitl/uav{drone}.position.json")


def test_px4_stands_where_each_stand_in_stood() -> None:
    services = _services(OVERRIDES["AUTOPILOT"]["px4"])
    assert set(services) == {f"sitl{drone}" for drone in _fleet()["drones"]}
    for sitl in services.values():
        assert sitl["environment"] == {"SITL_AUTOPILOT": "px4"}
        assert not {"command", "entrypoint", "network_mode"} & set(sitl)


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
