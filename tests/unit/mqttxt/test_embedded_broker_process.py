"""An embedded broker ends with the process that runs it, even one that is killed; when it dies alone it comes back."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mqttxt.core import embedded_broker as broker_module
from mqttxt.core import mosquitto
from mqttxt.core.embedded_broker import EmbeddedBroker
from mqttxt.errors import ConfigurationError
from mqttxt.security.authority import Authority
from mqttxt.security.broker import BrokerFiles
from tests.rigs.processes import eventually, free_port, listens, wait_until

RUN_BROKER = """
import asyncio, sys
from pathlib import Path
from mqttxt.core.embedded_broker import EmbeddedBroker
from mqttxt.security.broker import BrokerFiles
_, program, port, *identity = sys.argv
files = BrokerFiles(Path(*identity)) if identity else None
asyncio.run(EmbeddedBroker("127.0.0.1", int(port), program=program, files=files).run())
"""
BECOMES_ANOTHER = """#!{python}
import os, pathlib, time
pathlib.Path({told!r}).write_text(str(os.getpid()))
os.setuid({other})
time.sleep(600)
"""
NOBODY = 65534


def made(folder: Path, text: str) -> Path:
    """A program in the place of Mosquitto's."""
    path = folder / "mosquitto"
    path.write_text(text)
    path.chmod(0o755)
    return path


def runs(pid: int) -> bool:
    """Whether a process is there and not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@contextlib.contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A role of its own that runs an embedded broker."""
    role = subprocess.Popen([sys.executable, "-c", RUN_BROKER, *arguments])
    try:
        yield role
    finally:
        role.kill()
        role.wait()


def ends_with(role: subprocess.Popen[bytes], broker: int) -> None:
    """Kill the role; its broker has to end, too."""
    os.kill(role.pid, signal.SIGKILL)
    role.wait()
    wait_until(lambda: not runs(broker), "the broker ended, too")


@pytest.mark.skipif(sys.platform != "linux", reason="prctl(2) is Linux's")
def test_the_broker_of_a_killed_role_does_not_live_on_and_hold_its_port(tmp_path: Path) -> None:
    told = tmp_path / "pid"
    program = made(tmp_path, f"#!/bin/sh\necho $$ > {told}\nexec sleep 600\n")
    with running(str(program), "18830") as role:
        wait_until(lambda: told.exists() and told.read_text().strip(), "the broker runs")
        broker = int(told.read_text())
        assert runs(broker)
        ends_with(role, broker)


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="root's Mosquitto alone becomes another user")
def test_roots_broker_that_becomes_another_user_ends_with_a_killed_role(tmp_path: Path) -> None:
    """Changing its user rids it of the signal that its parent's end sends (prctl(2))."""
    told = tmp_path / "pid"
    program = made(tmp_path, BECOMES_ANOTHER.format(python=sys.executable, other=NOBODY, told=str(told)))
    with running(str(program), "18830") as role:
        wait_until(lambda: told.exists() and told.read_text(), "the broker runs")
        broker = int(told.read_text())
        wait_until(lambda: _owner(broker) == NOBODY, "it is another user's")
        ends_with(role, broker)


@pytest.mark.skipif(mosquitto.find() is None or os.geteuid() != 0, reason="takes root, and a Mosquitto on this machine")
@pytest.mark.parametrize("owner", [None, 0, NOBODY], ids=["plain", "root's key", "another's key"])
def test_a_real_mosquitto_of_root_ends_with_a_killed_role(tmp_path: Path, owner: int | None) -> None:
    identity: list[str] = []
    if owner is not None:
        folder = Authority.create(tmp_path / "acme", "acme").issue("broker-fog1")
        for path in (folder, *folder.iterdir()):
            os.chown(path, owner, owner)
        for path in folder.parents:
            if path.stat().st_mode & 0o5 != 0o5:
                path.chmod(0o755)
        identity = [str(folder)]
    port = free_port()
    with running(str(mosquitto.find()), str(port), *identity) as role:
        wait_until(lambda: listens(port), "the broker listens")
        children = map(int, Path(f"/proc/{role.pid}/task/{role.pid}/children").read_text().split())
        (broker,) = (child for child in children if Path(f"/proc/{child}/comm").read_text() == "mosquitto\n")
        wait_until(lambda: (_owner(broker) == 0) is (owner == 0), "it is who it is to be")
        ends_with(role, broker)


def _owner(pid: int) -> int:
    return Path(f"/proc/{pid}").stat().st_uid


class Lives:
    """A Mosquitto of which it is laid down how each of its lives goes; after those it stays up."""

    RUNS = "echo '1: mosquitto version 2.0.21 running' >&2"
    KILLED = "kill -KILL $$"
    TAKEN = "echo '1: Error: Address already in use' >&2; exit 1"
    SLOW = "sleep 1.2"

    def __init__(self, folder: Path, *lives: str) -> None:
        self._folder = folder
        cases = "\n".join(f"{number}) {life} ;;" for number, life in enumerate(lives, 1))
        self.program = made(
            folder,
            f"#!/bin/sh\necho life >> {folder}/lives\n"
            f"case $(wc -l < {folder}/lives) in\n{cases}\n*) {self.RUNS}; exec sleep 600 ;;\nesac\n",
        )

    @property
    def begun(self) -> int:
        counted = self._folder / "lives"
        return counted.read_text().count("life") if counted.exists() else 0

    async def run(self, until: int, waits: bool = False) -> None:
        """Run the embedded broker until so many lives have begun; raises what ends it before."""
        running = asyncio.create_task(EmbeddedBroker("127.0.0.1", 18830, program=str(self.program)).run(waits))
        try:
            async with asyncio.timeout(20):
                while self.begun < until:
                    await asyncio.wait({running}, timeout=0.02)
                    if running.done():
                        running.result()
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(broker_module, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(broker_module, "LONGEST_PAUSE_S", 0.02)


@pytest.mark.parametrize(
    "lives",
    [
        (f"{Lives.RUNS}; {Lives.KILLED}",),
        (f"{Lives.RUNS}; exit 1",),
        (Lives.KILLED, Lives.KILLED),
        (f"{Lives.RUNS}; {Lives.KILLED}", Lives.TAKEN, Lives.TAKEN),
    ],
    ids=["it dies", "it fails by itself", "it is killed before it runs", "something holds its port"],
)
async def test_a_broker_that_ends_as_soon_as_it_runs_or_before_comes_back(
    tmp_path: Path, lives: tuple[str, ...]
) -> None:
    await Lives(tmp_path, *lives).run(until=len(lives) + 1)


@pytest.mark.parametrize("fault", [errno.EAGAIN, errno.ENOMEM, errno.ENOENT])
async def test_a_broker_that_ran_is_tried_again_while_no_process_can_be_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: int
) -> None:
    forks, real = [], asyncio.create_subprocess_exec
    lives = Lives(tmp_path, f"{Lives.RUNS}; {Lives.KILLED}")

    async def forked(*arguments: Any, **options: Any) -> Any:
        if lives.begun == 1:
            forks.append(arguments)
            if len(forks) < 4 and arguments[0] == str(lives.program):
                raise OSError(fault, os.strerror(fault))
        return await real(*arguments, **options)

    monkeypatch.setattr(asyncio, "create_subprocess_exec", forked)
    await lives.run(until=2)


async def test_a_first_start_waits_for_room_for_a_process_and_for_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    faults, real = [errno.EAGAIN, errno.EAGAIN], asyncio.create_subprocess_exec

    async def forked(*arguments: Any, **options: Any) -> Any:
        if faults:
            raise OSError(faults[0], os.strerror(faults.pop(0)))
        return await real(*arguments, **options)

    monkeypatch.setattr(asyncio, "create_subprocess_exec", forked)
    await Lives(tmp_path).run(until=1)
    faults.append(errno.EACCES)
    with pytest.raises(PermissionError):
        await Lives(tmp_path).run(until=2)


async def test_a_broker_that_hangs_does_not_hold_up_the_end_of_its_role(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(broker_module, "ENDING_S", 0.1)
    told = tmp_path / "pid"
    program = made(tmp_path, f"#!/bin/sh\ntrap '' TERM\necho $$ > {told}\nwhile true; do sleep 0.05; done\n")
    running = asyncio.create_task(EmbeddedBroker("127.0.0.1", 18830, program=str(program)).run())
    await eventually(lambda: told.exists() and told.read_text() != "", "it hangs")
    running.cancel()
    _, goes_on = await asyncio.wait({running}, timeout=20)
    is_there = runs(int(told.read_text()))
    os.kill(int(told.read_text()), signal.SIGKILL) if is_there else None
    assert (goes_on, is_there) == (set(), False)


@pytest.mark.parametrize("fault", [errno.EADDRINUSE, errno.EADDRNOTAVAIL])
async def test_a_broker_that_waits_starts_once_its_address_is_there_and_free(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, fault: int
) -> None:
    no_address = f"echo '1795803987: Error: {os.strerror(fault)}' >&2; exit 1"
    await Lives(tmp_path, no_address, no_address).run(until=3, waits=True)
    assert caplog.messages == [
        f"--listen 127.0.0.1:18830: {os.strerror(fault)}; the broker starts once it can listen there"
    ]


async def test_a_broker_that_waits_waits_for_nothing_else(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"ended with code 1: 1: Error: Permission denied$"):
        await Lives(tmp_path, "echo '1: Error: Permission denied' >&2; exit 1").run(until=2, waits=True)


class Files:
    """What a broker's identity writes, without one."""

    is_list_readable = True

    def write(self, out: Path, host: str, port: int, newest: object = None) -> Path:
        return out / "mosquitto.conf"

    def write_access(self, out: Path, newest: object = None) -> None:
        """Nothing."""

    def take_outlived(self) -> set[str]:
        return set()


@pytest.fixture
def sighup_is_heard() -> Iterator[None]:
    """Below nohup it is ignored, and a shell cannot trap it then."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.long
@pytest.mark.usefixtures("sighup_is_heard")
async def test_a_broker_that_is_still_starting_is_told_of_a_newer_list_once_it_runs(tmp_path: Path) -> None:
    """Mosquitto without a handler is ended by SIGHUP."""
    lives = Lives(tmp_path, f"sleep 0.5; trap 'touch {tmp_path}/hup' HUP; {Lives.RUNS}; while :; do sleep 0.05; done")
    files: Any = Files()
    broker = EmbeddedBroker("127.0.0.1", 18830, program=str(lives.program), files=files)
    running = asyncio.create_task(broker.run())
    try:
        while lives.begun < 1 and not running.done():
            await asyncio.sleep(0.01)
        broker.reload()
        while not (tmp_path / "hup").exists() and not running.done():
            await asyncio.sleep(0.01)
        assert not running.done(), running
        assert lives.begun == 1
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


@pytest.mark.long
@pytest.mark.parametrize("how", [Lives.TAKEN, f"{Lives.SLOW}; {Lives.TAKEN}"], ids=["at once", "on a slow machine"])
async def test_a_broker_that_cannot_start_ends_its_role_with_what_it_said(tmp_path: Path, how: str) -> None:
    lives = Lives(tmp_path, how)
    with pytest.raises(ConfigurationError, match=r"^--listen 127.0.0.1:18830: .*code 1: .*already in use$"):
        await lives.run(until=2)
    assert lives.begun == 1


def full_disk(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class NoRoom:
    """Where the disk has no room for the broker's files, and what then takes them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        self._patch = monkeypatch
        self.files: Any = BrokerFiles(Authority.create(tmp_path / "acme", "acme").issue("broker-fog1"))

    def for_a_folder(self) -> None:
        """As tempfile ends, which tries each folder that there may be."""
        self._patch.setattr(tempfile, "tempdir", None)
        self._patch.setattr(tempfile, "_candidate_tempdir_list", list)

    def for_a_plain_file(self) -> None:
        self.files = None
        self._patch.setattr(Path, "write_text", full_disk)

    def for_an_identity(self) -> None:
        self._patch.setattr(os, "fsync", full_disk)


@pytest.mark.long
@pytest.mark.parametrize("no_room", [NoRoom.for_a_folder, NoRoom.for_a_plain_file, NoRoom.for_an_identity])
async def test_a_full_disk_ends_no_role_and_the_broker_starts_once_there_is_room(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, no_room: Callable[[NoRoom], None]
) -> None:
    lives = Lives(tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        room = NoRoom(patch, tmp_path)
        no_room(room)
        broker = EmbeddedBroker("127.0.0.1", 18830, program=str(lives.program), files=room.files)
        running = asyncio.create_task(broker.run())
        await eventually(lambda: running.done() or "once its files can be written" in caplog.text, "the line")
        assert not running.done(), running
        assert lives.begun == 0
    try:
        await eventually(lambda: running.done() or lives.begun == 1, "the broker")
        assert not running.done(), running
        assert caplog.text.count("once its files can be written") == 1
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def test_an_identity_that_is_not_whole_is_a_users_mistake(tmp_path: Path) -> None:
    lives = Lives(tmp_path)
    files = BrokerFiles(Authority.create(tmp_path / "acme", "acme").issue("broker-fog1"))
    (files.identity.folder / "members.pem").unlink()
    with pytest.raises(ConfigurationError, match=r"members\.pem"):
        await EmbeddedBroker("127.0.0.1", 18830, program=str(lives.program), files=files).run()
