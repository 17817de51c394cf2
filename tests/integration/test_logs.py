"""`mqttxt gs logs` as people type it, over real brokers and processes that are killed, with the stand-in's logs."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from sitl.logs import MADE_UP, made_up
from tests.rigs.processes import ROOT, System, wait_until

pytestmark = [pytest.mark.integration]

LATER = made_up(*MADE_UP[1])
Begun = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def begun(shared_system: System) -> Begun:
    cloud = ("--cloud", shared_system.cloud.url)

    def begin(*words: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "mqttxt", "gs", "logs", *words, "--drone", "1", *cloud]
        return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    return begin


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Its exit code and what it said."""
    out, error = process.communicate(timeout=120)
    return process.returncode, out, error


def test_logs_are_listed_and_written_into_a_file(begun: Begun, tmp_path: Path) -> None:
    code, out, error = ended(begun("list"))
    assert (code, out.splitlines()) == (
        0,
        ["    0       40000 2026-01-01 00:00:00", "    1      120000 2026-01-01 01:00:00"],
    ), error
    file = tmp_path / "flight.ulg"
    code, out, error = ended(begun("get", "0", str(file)))
    assert (code, out) == (0, f"{file}: 40000 bytes\n"), error
    assert file.read_bytes() == made_up(*MADE_UP[0]).data
    assert [path.name for path in tmp_path.iterdir()] == ["flight.ulg"]


def test_a_killed_station_and_a_killed_drone_cost_no_more_than_a_block(
    begun: Begun, shared_system: System, tmp_path: Path
) -> None:
    """The drone dies while it reads, the station while bytes come, and the command is typed again."""
    file = tmp_path / "flight.ulg"
    folder = shared_system.folder / "uav1.logs"
    for left in folder.iterdir():
        left.unlink()
    first = begun("get", "1", str(file))
    wait_until(lambda: any(path.stat().st_size > 0 for path in folder.glob("*.part")), "a block is on the disk")
    shared_system.uavs[1].kill()
    shared_system.uavs[1].start().wait_ready()
    code, _, error = ended(first)
    assert code == 0, error
    assert file.read_bytes() == LATER.data
    file.unlink()
    second = begun("get", "1", str(file), "--most-kib-s", "8")

    def come() -> int:
        return sum(path.stat().st_size for path in tmp_path.glob(".flight.ulg.*.part"))

    wait_until(lambda: come() > 20_000, "some of it has come")
    second.send_signal(signal.SIGKILL)
    second.communicate()
    before = come()
    assert before > 20_000
    assert not file.exists()
    code, _, error = ended(begun("get", "1", str(file)))
    assert code == 0, error
    assert file.read_bytes() == LATER.data
    assert not list(tmp_path.glob(".flight.ulg.*"))
