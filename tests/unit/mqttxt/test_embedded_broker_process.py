"""An embedded broker ends with the process that runs it, even one that is killed; when it dies alone it comes back."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mqttxt.core import embedded_broker as broker_module
from mqttxt.core.embedded_broker import EmbeddedBroker
from mqttxt.errors import ConfigurationError

RUN_BROKER = """
import asyncio, sys
from mqttxt.core.embedded_broker import EmbeddedBroker
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


class Lives:
    """A Mosquitto of which it is laid down how each of its lives goes; after those it stays up."""

    RUNS = "echo '1: mosquitto version 2.0.21 running' >&2"
    KILLED = "kill -KILL $$"
    TAKEN = "echo '1: Error: Address already in use' >&2; exit 1"
    SLOW = "sleep 1.2"

    def __init__(self, folder: Path, *lives: str) -> None:
        self._folder = folder
        self.program = folder / "mosquitto"
        cases = "\n".join(f"{number}) {life} ;;" for number, life in enumerate(lives, 1))
        self.program.write_text(
            f"#!/bin/sh\necho life >> {folder}/lives\n"
            f"case $(wc -l < {folder}/lives) in\n{cases}\n*) {self.RUNS}; exec sleep 600 ;;\nesac\n"
        )
        self.program.chmod(0o755)

    @property
    def begun(self) -> int:
        counted = self._folder / "lives"
        return counted.read_text().count("life") if counted.exists() else 0

    async def run(self, until: int) -> None:
        """Run the embedded broker until so many lives have begun; raises what ends it before."""
        running = asyncio.create_task(EmbeddedBroker("127.0.0.1", 18830, program=str(self.program)).run())
        try:
            async with asyncio.timeout(20):
                while self.begun < until:
                    await asyncio.wait({running}, timeout=0.02)
                    if running.done():
                        running.result()
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(broker_module, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(broker_module, "LONGEST_PAUSE_S", 0.02)


@pytest.mark.usefixtures("impatient")
async def test_a_broker_that_dies_as_soon_as_it_runs_comes_back(tmp_path: Path) -> None:
    await Lives(tmp_path, f"{Lives.RUNS}; {Lives.KILLED}").run(until=2)


@pytest.mark.usefixtures("impatient")
async def test_a_broker_that_fails_by_itself_as_soon_as_it_runs_comes_back(tmp_path: Path) -> None:
    await Lives(tmp_path, f"{Lives.RUNS}; exit 1").run(until=2)


@pytest.mark.usefixtures("impatient")
async def test_a_broker_that_is_killed_before_it_runs_comes_back(tmp_path: Path) -> None:
    await Lives(tmp_path, Lives.KILLED, Lives.KILLED).run(until=3)


@pytest.mark.usefixtures("impatient")
async def test_a_broker_that_ran_is_tried_again_while_something_holds_its_port(tmp_path: Path) -> None:
    await Lives(tmp_path, f"{Lives.RUNS}; {Lives.KILLED}", Lives.TAKEN, Lives.TAKEN).run(until=4)


@pytest.mark.parametrize("how", [Lives.TAKEN, f"{Lives.SLOW}; {Lives.TAKEN}"], ids=["at once", "on a slow machine"])
async def test_a_broker_that_cannot_start_ends_its_role_with_what_it_said(tmp_path: Path, how: str) -> None:
    lives = Lives(tmp_path, how)
    with pytest.raises(ConfigurationError, match=r"^embedded broker 127.0.0.1:18830: .*code 1: .*already in use$"):
        await lives.run(until=2)
    assert lives.begun == 1
