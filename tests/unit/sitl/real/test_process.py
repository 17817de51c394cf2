"""An autopilot as a child process: a program that is made up, watched and ended as a real one."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from sitl.errors import AutopilotDied, SitlError
from sitl.real import process
from sitl.real.process import fly
from sitl.real.watching import Watching
from tests.rigs.processes import eventually, free_port

BEATS = """
import signal, socket, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job starts with it ignored
from pymavlink.dialects.v20 import common as mavlink
codec, sock = mavlink.MAVLink(None, 3, 1), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
to = ("127.0.0.1", int(sys.argv[1]))
print("it runs", flush=True)
try:
    while True:
        for message in (
            mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3),
            mavlink.MAVLink_global_position_int_message(1, 473977420, 85455940, 488000, 0, 0, 0, 0, 0),
            mavlink.MAVLink_sys_status_message(0, 0, mavlink.MAV_SYS_STATUS_PREARM_CHECK, *[0] * 10),
        ):
            sock.sendto(message.pack(codec), to)
        time.sleep(0.02)
except KeyboardInterrupt:
    open("ended", "w").close()
"""


class MadeUp:
    """An autopilot that is a Python program; `answer` is what its only parameter is read back as."""

    def __init__(self, work: Path, program: str, port: int, answer: str = "right") -> None:
        self.work = work
        self._words = [sys.executable, "-c", program, str(port)]
        self._answer = answer

    def prepare(self) -> tuple[list[str], dict[str, str]]:
        return self._words, dict(os.environ)

    def questions(self) -> dict[str, list[str]]:
        return {"ITS_PARAMETER": ["echo", self._answer]}

    def check(self, answers: Mapping[str, str]) -> None:
        if answers != {"ITS_PARAMETER": "right"}:
            raise SitlError(f"ITS_PARAMETER is {answers['ITS_PARAMETER']}; expected right")


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine takes longer to end a program than two seconds."""
    monkeypatch.setattr(process, "END_S", 60.0)


@pytest.mark.long
async def test_it_is_ready_once_it_is_checked_and_ended_with_who_started_it(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    port, ready = free_port(socket.SOCK_DGRAM), tmp_path / "ready"
    watching = Watching(3, ("127.0.0.1", port), ready_file=ready)
    flight = asyncio.create_task(fly(MadeUp(tmp_path, BEATS, port), watching))
    await eventually(ready.exists, "it is ready")
    flight.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await flight
    assert (tmp_path / "ended").exists()
    assert "it runs" in capfd.readouterr().out


async def test_one_that_dies_is_said_with_its_exit_code_and_what_it_printed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    port = free_port(socket.SOCK_DGRAM)
    dying = MadeUp(tmp_path, "print('Error opening startup file'); raise SystemExit(255)", port)
    with pytest.raises(AutopilotDied, match="ended with exit code 255"):
        await fly(dying, Watching(3, ("127.0.0.1", port)))
    assert "Error opening startup file" in capfd.readouterr().out


async def test_a_setting_that_it_did_not_take_ends_it(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    with pytest.raises(SitlError, match="ITS_PARAMETER is wrong; expected right"):
        await fly(MadeUp(tmp_path, BEATS, port, answer="wrong"), Watching(3, ("127.0.0.1", port)))
    assert (tmp_path / "ended").exists()


async def test_a_program_that_cannot_be_started_is_one_line(tmp_path: Path) -> None:
    port, missing = free_port(socket.SOCK_DGRAM), MadeUp(tmp_path, "", 0)
    missing._words[0] = str(tmp_path / "none")
    with pytest.raises(AutopilotDied, match=r"none: No such file or directory"):
        await fly(missing, Watching(3, ("127.0.0.1", port)))
