"""What `mqttxt gs params` prints, sets and keeps, with a drone that is not there."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import Result

from mqttxt import CommandId, Outcome, Parameter, Parameters, ParameterType, SetParameter, Word
from mqttxt.cli import station
from mqttxt.cli.common import run_coroutine
from mqttxt.protocol.parameters import ParameterSet
from tests.unit.mqttxt.typed import refused, typed

REAL32, INT32 = ParameterType.REAL32, ParameterType.INT32


class Drone:
    """Parameters in a dictionary; `denied` are names that it does not set. `asked` is what a station had already."""

    fog, number, prefix = 1, 3, ""

    def __init__(self) -> None:
        self.set = ParameterSet.of(
            [Parameter("A_FLOAT", REAL32, 0.1), Parameter("A_WHOLE", INT32, -5), Parameter("ODD", REAL32, None)]
        )
        self.denied: set[str] = set()
        self.asked: list[Parameters | None] = []

    async def parameters(self, known: Parameters | None = None) -> Parameters:
        self.asked.append(known)
        return known if known is not None and known.content.hash == self.set.hash else Parameters(self.set)

    async def send(self, command: SetParameter) -> Outcome:
        return await self.set_parameter(command.parameter, command.value)

    async def set_parameter(self, name: str, value: float, **_: float) -> Outcome:
        word, reason = (Word.DENIED, "parameter_not_enabled") if name in self.denied else (Word.COMPLETED, None)
        if word is Word.COMPLETED:
            self.set = self.set.with_one(Parameter(name, self.set.parameters[name].type, value))
        return Outcome(CommandId(1, 1), 1, self.number, "set_parameter", word, reason)


@pytest.fixture
def drone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Drone:
    there = Drone()
    monkeypatch.setattr(station, "run_with_drone", lambda job, *_: run_coroutine(job(there)))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return there


def params(command: str, *words: object) -> Result:
    return typed("gs", "params", command, "--drone", 3, *words)


def test_a_list_has_names_values_and_types(drone: Drone) -> None:
    result = params("list", "A_*")
    assert [line.split() for line in result.stdout.splitlines()] == [
        ["A_FLOAT", "0.1", "real32"],
        ["A_WHOLE", "-5", "int32"],
    ]
    assert (params("list", "NONE*").exit_code, params("list").stdout.count("\n")) == (1, 3)


def test_values_are_printed_in_the_order_of_the_names(drone: Drone) -> None:
    assert params("get", "ODD", "A_WHOLE").stdout == "nan\n-5\n"
    said = refused("gs", "params", "get", "--drone", 3, "A_WHOLE", "NOBODY")
    assert said == "NOBODY: drone 3 has no such parameter"


def test_what_was_fetched_before_is_said_to_be_known(drone: Drone, tmp_path: Path) -> None:
    params("list")
    params("list")
    assert drone.asked == [None, Parameters(drone.set)]
    (kept,) = (tmp_path / "cache" / "mqttxt" / "parameters").iterdir()
    kept.write_bytes(b"nonsense")
    params("list")
    assert drone.asked[-1] is None
    assert Parameters(ParameterSet.unpacked(kept.read_bytes())) == Parameters(drone.set)


def test_what_is_kept_of_a_drone_is_of_its_fleet(drone: Drone, tmp_path: Path) -> None:
    for prefix in ("acme/", "acme/north/", ""):
        drone.prefix = prefix
        params("list")
    assert drone.asked == [None] * 3
    kept = {path.name for path in (tmp_path / "cache" / "mqttxt" / "parameters").iterdir()}
    assert kept == {"acme%2Ffog1-drone3", "acme%2Fnorth%2Ffog1-drone3", "fog1-drone3"}


def test_what_a_full_disk_does_not_keep_is_printed_all_the_same(
    drone: Drone, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "cache").write_text("no folder")
    assert params("get", "A_WHOLE").stdout == "-5\n"
    assert "next time all parameters are fetched" in caplog.text


def test_a_file_that_was_saved_differs_where_something_was_set(drone: Drone, tmp_path: Path) -> None:
    file = tmp_path / "drone3.params"
    assert params("save", file).stdout == f"{file}: 3 parameters\n"
    assert (params("diff", file).exit_code, params("diff", file).stdout) == (0, "")
    assert params("set", "A_FLOAT", "0.7").exit_code == 0
    differing = params("diff", file)
    assert (differing.exit_code, differing.stdout) == (1, "A_FLOAT: 0.1 and 0.7\n")
    loaded = params("load", file)
    assert loaded.exit_code == 0
    assert loaded.stdout.splitlines()[-1] == "1 of 1 parameters were set"
    assert params("diff", file).exit_code == 0


def test_a_negative_number_is_set_as_any_other(drone: Drone) -> None:
    assert (params("set", "A_WHOLE", "-7").exit_code, drone.set.parameters["A_WHOLE"].value) == (0, -7)
    assert "--dron" in refused("gs", "params", "set", "--drone", 3, "A_WHOLE", 7, "--dron", 4)


def test_one_that_is_not_set_is_told_and_the_others_are_set(drone: Drone, tmp_path: Path) -> None:
    file = tmp_path / "drone3.params"
    file.write_text("1\t1\tA_FLOAT\t2\t9\n1\t1\tA_WHOLE\t2\t6\n")
    drone.denied = {"A_FLOAT"}
    result = params("load", file)
    assert result.exit_code == 1
    assert "A_FLOAT 2: " in result.stdout
    assert "denied(parameter_not_enabled)" in result.stdout
    assert result.stdout.splitlines()[-1] == "1 of 2 parameters were set"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1\t1\tNOBODY\t2\t9", "NOBODY: the drone has no such parameter; nothing was set"),
        ("1\t1\tA_WHOLE\t2\t9", "A_WHOLE: type: expected 6 (int32), got 9 (real32); nothing was set"),
        ("1\t1\tA_FLOAT\tnan\t9", "A_FLOAT: expected a number, got nan; nothing was set"),
    ],
)
def test_a_file_that_the_drone_cannot_take_sets_nothing(drone: Drone, tmp_path: Path, line: str, said: str) -> None:
    file = tmp_path / "drone3.params"
    file.write_text(f"1\t1\tODD\t5\t9\n{line}\n")
    before = drone.set
    assert refused("gs", "params", "load", "--drone", 3, file) == f"{file}: {said}"
    assert drone.set == before
