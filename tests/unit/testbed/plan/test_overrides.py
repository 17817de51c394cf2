"""Which compose files AUTOPILOT and ROUTER lay over compose.yaml, and what they say."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from testbed.cli import commands as cli
from testbed.fly.flights import settings_of
from testbed.plan.autopilots import KINDS
from testbed.plan.compose import COMPOSE_FILE
from testbed.plan.documents import ROOT
from testbed.plan.experiments import make_plan
from testbed.plan.fleets import fleet_of, standard_fleet
from testbed.plan.overrides import FLEET_COPY, OVERRIDES, chosen, compose_files, fleet_in, suffix
from tests.handmade.autopilot_folders import make_folder


def test_without_a_variable_nothing_is_laid_over(tmp_path: Path) -> None:
    assert chosen({"AUTOPILOT": "", "HOME": "/"}) == {}
    assert compose_files({}, standard_fleet(), tmp_path) == [COMPOSE_FILE]


def test_an_autopilot_and_a_router_come_behind_the_compose_file(tmp_path: Path) -> None:
    settings = chosen({"ROUTER": "official", "AUTOPILOT": "px4"})
    assert settings == {"AUTOPILOT": "px4", "ROUTER": "official", "AUTOPILOT_IMAGE": "px4io/px4-sitl:v1.17.0"}
    assert [path.name for path in compose_files(settings, standard_fleet(), tmp_path)] == [
        "compose.yaml",
        "px4.yaml",
        "official.yaml",
    ]


def test_a_file_of_ones_own_is_named_by_its_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.yaml").write_text("services: {}\n")
    monkeypatch.chdir(tmp_path)
    assert compose_files(chosen({"AUTOPILOT": "mine.yaml"}), standard_fleet(), tmp_path) == [
        COMPOSE_FILE,
        tmp_path / "mine.yaml",
    ]


def test_the_files_of_another_fleet_are_made_in_the_runs_folder(tmp_path: Path) -> None:
    fleet, checked_in = fleet_of({"FOGS": "3", "DRONES": "12"}), COMPOSE_FILE.read_text()
    mine = tmp_path / "of-mine" / "mine.yaml"
    mine.parent.mkdir()
    mine.write_text("services: {}\n")
    files = compose_files({"AUTOPILOT": "px4", "ROUTER": str(mine)}, fleet, tmp_path)
    assert files == [tmp_path / "compose.yaml", tmp_path / "px4.yaml", mine]
    assert COMPOSE_FILE.read_text() == checked_in
    assert set(_services(files[1])) == {f"sitl{drone}" for drone in range(1, 13)} < set(_services(files[0]))
    assert fleet_in(tmp_path) == fleet


def test_a_folder_of_another_fleet_is_the_experiments_again_once_that_is_up(tmp_path: Path) -> None:
    assert fleet_in(tmp_path) == standard_fleet()
    compose_files({}, fleet_of({"DRONES": "3"}), tmp_path)
    assert fleet_in(tmp_path) != standard_fleet()
    compose_files({}, standard_fleet(), tmp_path)
    assert fleet_in(tmp_path) == standard_fleet()


def test_what_the_containers_read_of_another_fleet_is_theirs_to_read(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        compose_files({}, fleet_of({"DRONES": "3"}), tmp_path)
    finally:
        os.umask(before)
    assert (tmp_path / FLEET_COPY).stat().st_mode & 0o004


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
    found: dict[str, Any] = yaml.safe_load((ROOT / "services" / "fleet.yaml").read_text())
    return found


def test_the_results_path_names_what_was_laid_over(tmp_path: Path) -> None:
    assert suffix({}) == suffix({"AUTOPILOT": "", "ROUTER": ""}) == ""
    assert suffix({"AUTOPILOT": "px4", "ROUTER": "official"}) == "+autopilot-px4+router-official"
    assert suffix({"AUTOPILOT": str(tmp_path / "mine.yaml")}) == "+autopilot-mine"
    assert suffix({"AUTOPILOT": "px4", "DRONES": "12"}) == "+fogs-2+drones-12+autopilot-px4"
