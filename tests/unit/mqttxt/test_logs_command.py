"""What `mqttxt gs logs` prints and refuses, with a drone that is not there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mqttxt import FlightLog, LogProgress, TransferFailed
from mqttxt.cli import station
from mqttxt.cli.common import run_coroutine
from tests.unit.mqttxt.typed import refused, typed


class Drone:
    """Two logs; `asked` is how a log was asked for, `refused` why the drone does not give its list."""

    number = 3

    def __init__(self) -> None:
        self.asked: list[int] = []
        self.refused: TransferFailed | None = None

    async def logs(self) -> tuple[FlightLog, ...]:
        if self.refused is not None:
            raise self.refused
        return (FlightLog(1, 500, None), FlightLog(12, 2**32 - 1, 1_767_225_600))

    async def download_log(
        self, log: FlightLog, path: Path, *, most_bytes_s: int, progress: Callable[[LogProgress], None]
    ) -> None:
        self.asked.append(most_bytes_s)
        for is_at_drone, done in ((False, 0), (False, 100), (True, 7)):
            progress(LogProgress(is_at_drone, done, log.size))
        path.write_bytes(bytes(log.size))


@pytest.fixture
def drone(monkeypatch: pytest.MonkeyPatch) -> Drone:
    there = Drone()
    monkeypatch.setattr(station, "run_with_drone", lambda job, *_: run_coroutine(job(there)))
    return there


def test_a_list_has_numbers_bytes_and_times(drone: Drone) -> None:
    lines = typed("gs", "logs", "list", "--drone", 3).stdout.splitlines()
    assert [line.split() for line in lines] == [["1", "500", "-"], ["12", "4294967295", "2026-01-01", "00:00:00"]]


def test_how_far_a_log_is_goes_to_stderr_now_and_then(drone: Drone, tmp_path: Path) -> None:
    file = tmp_path / "flight.ulg"
    result = typed("gs", "logs", "get", 1, file, "--most-kib-s", 2, "--drone", 3)
    assert (result.exit_code, result.stdout) == (0, f"{file}: 500 bytes\n")
    assert result.stderr == "0 of 500 bytes read from the autopilot\n"
    assert (file.stat().st_size, drone.asked) == (500, [2048])


def test_what_cannot_be_is_one_line_and_nothing_is_asked(drone: Drone, tmp_path: Path) -> None:
    for words, line in (
        ((7, tmp_path / "a"), "log 7: drone 3 has no such log; its logs: 1, 12"),
        ((1, tmp_path / "b" / "a"), f"{tmp_path}/b/a: no such folder; expected a file in a folder that exists"),
        ((1, tmp_path / "a", "--most-kib-s", 0), "--most-kib-s 0: expected 1 to 1000000"),
        ((1, tmp_path / "a", "--most-kib-s", "9" * 500), f"--most-kib-s {'9' * 500}: expected 1 to 1000000"),
    ):
        assert refused("gs", "logs", "get", *words, "--drone", 3) == line
    assert drone.asked == []


def test_an_armed_drone_is_said_to_have_to_be_disarmed(drone: Drone, tmp_path: Path) -> None:
    drone.refused = TransferFailed("drone 3: logs: armed", "armed")
    for words in (("list",), ("get", 1, tmp_path / "a")):
        result = typed("gs", "logs", *words, "--drone", 3)
        assert (result.exit_code, result.stderr) == (
            1,
            "mqttxt: drone 3: logs: armed; expected a disarmed drone\n",
        )


def test_a_folder_of_no_bytes_is_refused() -> None:
    said = refused("uav", "--drone", 1, "--broker", "mqtt://127.0.0.1:1", "--logs-limit-mb", 0)
    assert said == "--logs-limit-mb 0: expected 1 or more"
