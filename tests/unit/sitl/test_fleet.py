"""The fleet's configuration, and one clear line for each mistake in it."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from sitl.cli import app, main
from sitl.errors import SitlError
from sitl.fleet import load

SHIPPED = Path(__file__).parents[3] / "services" / "fleet.yaml"
GOOD = "{latitude_deg: 47, longitude_deg: 8, altitude_m: 400, capacity_wh: 60, charge_pct: 90"


def test_the_shipped_fleet_has_six_different_drones() -> None:
    drones = [load(SHIPPED, number) for number in range(1, 7)]
    assert len({drone.home for drone in drones}) == 6
    assert len({drone.parameters["MPC_XY_VEL_MAX"] for drone in drones}) == 6
    assert len({drone.charge_pct for drone in drones}) == 6
    for group in (drones[:3], drones[3:]):
        first = group[0].home
        for drone in group[1:]:
            north, east = first.metres_to(drone.home.latitude_deg, drone.home.longitude_deg)
            assert 20 <= (north**2 + east**2) ** 0.5 <= 60


def test_a_drones_own_parameters_go_before_the_fleets(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(f"parameters: {{RTL_RETURN_ALT: 10}}\ndrones:\n  1: {GOOD}, parameters: {{RTL_RETURN_ALT: 20}}}}\n")
    assert load(path, 1).parameters == {"RTL_RETURN_ALT": 20}


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("[", "not YAML"),
        ("\udcff", "not UTF-8"),
        ("fleet: 1", "drones: expected a mapping"),
        (f"drones: {{2: {GOOD}}}}}", "drones: no drone 1; expected one of 2"),
        (
            f"wind: 3\ndrones: {{1: {GOOD}}}}}",
            "wind: expected fogs, addresses, .*, drones only",
        ),
        ("drones: {1: here}", "drones.1: expected a mapping, got 'here'"),
        ("drones: {1: {latitude_deg: 47}}", "drones.1: altitude_m, capacity_wh, .* is missing"),
        (f"drones: {{1: {GOOD}, wings: 2}}}}", "drones.1: wings is not known"),
        (f"drones: {{1: {GOOD}, parameters: 3}}}}", "drones.1.parameters: expected a mapping"),
        (
            f"drones: {{1: {GOOD}, parameters: {{WIND: 3}}}}}}",
            "drones.1.parameters.WIND: expected one of BAT1_CAPACITY",
        ),
        (
            f"drones: {{1: {GOOD}, parameters: {{MPC_ACC_HOR: .nan}}}}}}",
            "MPC_ACC_HOR: expected a number from 2 to 15, got nan",
        ),
        (
            f"drones: {{1: {GOOD.replace('90', '101')}}}}}",
            "drones.1.charge_pct: expected a number from 0 to 100, got 101",
        ),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, text: str, error: str) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(SitlError, match=error) as caught:
        load(path, 1)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (["--system", "251"], "--system 251: expected 1 to 250"),
        (["--streams", "all"], "--streams 'all': expected one of px4-onboard, px4-normal, px4-gcs, five-states"),
        (["--like", "dji"], "--like 'dji': expected one of px4, ardupilot"),
        (["--like", ""], "--like '': expected one of px4, ardupilot"),
        (["--like", "px4", "--autopilot", "px4"], "--like 'px4': px4 is like itself; expected without --like"),
        (["--listen", "14580"], "--listen '14580': expected HOST:PORT"),
        (["--send", "127.0.0.1:0"], "--send '127.0.0.1:0': expected a port"),
        (["--fleet", "/nowhere.yaml"], "/nowhere.yaml: No such file or directory"),
        (["--listen", "192.0.2.1:14580"], "cannot receive on 192.0.2.1:14580: "),
        (["--listen", "127.0.0.1:0", "--control", "/nowhere/x.sock"], "--control /nowhere/x.sock: No such file"),
        (["--listen", "127.0.0.1:0", "--ready-file", "/nowhere/ready"], "--ready-file /nowhere/ready: No such file"),
        (["--listen", "127.0.0.1:0", "--events", "/proc/x/y.jsonl"], "--events /proc/x/y.jsonl: "),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_code_2(options: list[str], error: str) -> None:
    result = CliRunner().invoke(app, ["fly", *options])
    assert result.exit_code == 2
    assert error in result.output
    assert result.output.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fly", "--system", "one"], "Invalid value for '--system': "),
        (["fly", "--sistem", "1"], "No such option: --sistem"),
        (["fry"], "No such command 'fry'."),
    ],
)
def test_what_is_no_command_line_is_one_line_too(
    words: list[str], said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["sitl", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    line = capsys.readouterr().err
    assert (ended.value.code, line.count("\n")) == (2, 1)
    assert line.startswith(f"sitl: {said}")
