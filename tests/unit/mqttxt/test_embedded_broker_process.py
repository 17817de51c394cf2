"""An embedded broker ends with the process that runs it, even one that is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

RUN_BROKER = """
import asyncio, sys
from mqttxt.io.broker import EmbeddedBroker
asyncio.run(EmbeddedBroker("127.0.0.1", 18830, program=sys.argv[1]).run())
"""


def wait_for(condition: object, limit_s: float = 20.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline
        time.sleep(0.02)


def runs(pid: int) -> bool:
    """Whether a process is there and not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="prctl(2) is Linux's")
def test_the_broker_of_a_killed_role_does_not_live_on_and_hold_its_port(tmp_path: Path) -> None:
    told = tmp_path / "pid"
    program = tmp_path / "mosquitto"
    program.write_text(f"#!/bin/sh\necho $$ > {told}\nexec sleep 600\n")
    program.chmod(0o755)
    role = subprocess.Popen([sys.executable, "-c", RUN_BROKER, str(program)])
    try:
        wait_for(lambda: told.exists() and told.read_text().strip())
        broker = int(told.read_text())
        assert runs(broker)
        os.kill(role.pid, signal.SIGKILL)
        role.wait()
        wait_for(lambda: not runs(broker))
    finally:
        role.kill()
        role.wait()
