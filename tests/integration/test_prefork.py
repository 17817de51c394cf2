"""What runs as a fork of what has imported it is what `python -m` runs."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.rigs import prefork
from tests.rigs.processes import Process, free_port, wait_until

pytestmark = [pytest.mark.integration, pytest.mark.apart]


@pytest.mark.parametrize("words", [("--version",), ("gs", "send", "no-such-command"), ("uav",)], ids=str)
def test_it_says_and_ends_as_a_process_of_its_own_does(words: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "mqttxt", *words]
    alone = subprocess.run(command, cwd=prefork.ROOT, capture_output=True, text=True, timeout=60, check=False)
    forked = prefork.run("mqttxt", *words)
    assert (forked.returncode, forked.stdout, forked.stderr) == (alone.returncode, alone.stdout, alone.stderr)


def test_it_has_the_files_the_environment_and_the_folder_that_it_was_given(tmp_path: Path) -> None:
    process = _waiting(tmp_path)
    try:
        found = Path(f"/proc/{process.pid}")
        files = {int(file.name): os.readlink(file) for file in (found / "fd").iterdir()}
        assert [files[0], files[1], files[2]] == [os.devnull, str(process.log), str(process.log)]
        assert str(process.log) not in [name for number, name in files.items() if number > 2]
        assert os.readlink(found / "cwd") == str(prefork.ROOT)
    finally:
        process.kill()
    done = prefork.run("mqttxt", "gs", "send", "arm", environment={**os.environ, "MQTTXT_CLOUD": "nonsense"})
    assert done.returncode == 2
    assert "nonsense" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGABRT])
def test_a_signal_ends_it_and_is_its_exit_code(number: signal.Signals, tmp_path: Path) -> None:
    process = _waiting(tmp_path)
    process.signal(number)
    assert process.wait() == -number
    assert process.exit_code == -number
    process.kill()  # does nothing to whoever has its id now


def test_ctrl_c_reaches_it_and_not_who_forks(tmp_path: Path) -> None:
    process = _waiting(tmp_path)
    process.signal(signal.SIGINT)
    assert process.wait() in (0, 130, -signal.SIGINT)
    assert prefork.run("mqttxt", "--version").returncode == 0


def _waiting(folder: Path) -> Process:
    """A UAV client that waits for an autopilot."""
    autopilot = f"udp:127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    options = ["--drone", "1", "--broker", "mqtt://127.0.0.1:1", "--autopilot", autopilot]
    process = Process(folder, "uav", "mqttxt", "uav", *options, "--journal", str(folder / "journal")).start()
    wait_until(lambda: "waiting for the heartbeat" in process.said() or process.exit_code is not None, "it waits")
    assert process.exit_code is None, process.said()
    return process
