"""Which compose files AUTOPILOT and ROUTER lay over compose.yaml, and what they say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from autopilot_folders import make_folder
from typer.testing import CliRunner

from testbed.cli import commands as cli
from testbed.fly.flights import settings_of
from testbed.plan.autopilots import KINDS
from testbed.plan.experiments import make_plan
from testbed.plan.overrides import OVERRIDES, chosen, compose_files, suffix
from testbed.plan.topology import COMPOSE_FILE, ROOT


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


def test_an_ardupilot_flies_over_both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AUTOPILOT", "ardupilot")
    monkeypatch.setenv("ARDUPILOT_DIR", str(make_folder(tmp_path, KINDS["ardupilot"])))
    plan = make_plan("scenario-1", "1", "thesis", "ideal", "mqttxt,mavlink", {})
    for protocol in ("mqttxt", "mavlink"):
        settings = settings_of(plan, protocol)
        assert (settings["AUTOPILOT"], settings["AUTOPILOT_DIR"]) == ("ardupilot", str(tmp_path))


@pytest.mark.parametrize("kind", KINDS)
def test_a_real_autopilot_stands_where_each_stand_in_stood(kind: str) -> None:
    services = _services(OVERRIDES["AUTOPILOT"][kind])
    assert set(services) == {f"sitl{drone}" for drone in _fleet()["drones"]}
    for sitl in services.values():
        assert sitl["environment"] == {"SITL_AUTOPILOT": kind}
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
