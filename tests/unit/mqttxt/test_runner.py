"""The runner: a steady rate, whatever a tick takes, and a goodbye whatever ends it."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.core.effects import Inbound, Publish, Subscribe, Will
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.core.runner import TICK_S, Runner, next_tick
from mqttxt.errors import ConfigurationError
from tests.rigs.mqtt_server import DISCONNECT, PUBLISH, Server
from tests.rigs.processes import eventually

CLEAN = b""
PRESENCE = "drone1/reachable"


class Role:
    """Says `up` and `down` on each of its links; `fails` is raised by a tick once it has said `up`."""

    def __init__(self, *links: str) -> None:
        self.fails: Exception | None = None
        self.links = links
        self.connected: set[str] = set()
        self.ticks = 0

    def on_connected(self, link: str, now_ms: int) -> list[Any]:
        self.connected.add(link)
        return [Publish(link, PRESENCE, b"up", 1, retain=True)]

    def on_disconnected(self, link: str, now_ms: int) -> list[Any]:
        self.connected.discard(link)
        return []

    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> list[Any]:
        return []

    def on_message(self, link: str, message: Inbound, now_ms: int) -> list[Any]:
        return []

    def on_published(self, link: str, ref: Hashable, code: int, now_ms: int) -> list[Any]:
        return []

    def on_identity(self, now_ms: int) -> list[Any]:
        return []

    def tick(self, now_ms: int) -> list[Any]:
        self.ticks += 1
        if self.fails is not None:
            raise self.fails
        return []

    def goodbye(self, now_ms: int) -> list[Any]:
        return [Publish(link, PRESENCE, b"down", 1, retain=True) for link in self.connected]

    def is_ready(self, now_ms: int) -> bool:
        return True


def started(role: Role, server: Server, ready_file: Path | None = None) -> tuple[Runner, asyncio.Task[None]]:
    runner = Runner(role, SessionClock(), ready_file)
    for name in role.links:
        address = BrokerAddress("127.0.0.1", server.port)
        runner.links[name] = MqttLink(name, address, f"client-{name}", lambda: Will(PRESENCE, b"down"), runner)
    return runner, asyncio.create_task(runner.run())


def said(server: Server) -> list[list[bytes]]:
    """What each of the server's clients published, and the body of its DISCONNECT."""
    return [
        [*(p.publish()[2] for p in session.of(PUBLISH)), *(p.body for p in session.of(DISCONNECT))]
        for session in server.sessions
    ]


async def test_a_role_that_fails_says_goodbye_first() -> None:
    async with Server() as server:
        role = Role("fog")
        _, running = started(role, server)
        await eventually(lambda: said(server) == [[b"up"]], "the birth")
        role.fails = OSError("No space left on device")
        with pytest.raises(OSError, match="No space left"):
            await running
        await eventually(lambda: said(server) == [[b"up", b"down", CLEAN]], "the goodbye")


async def test_a_link_that_fails_ends_the_role_and_the_other_link_says_goodbye() -> None:
    async with Server() as server:
        _, running = started(Role("cloud", "fog"), server)
        await eventually(lambda: said(server) == [[b"up"]] * 2, "the births")
        server.sessions[0].send(b"\xe0\x02\x8e\x00")  # session taken over
        with pytest.raises(Exception, match="another client took over"):
            await running
        await eventually(lambda: said(server)[1] == [b"up", b"down", CLEAN], "the other's goodbye")


async def test_a_second_signal_ends_the_wait_for_the_goodbye_to_be_acknowledged() -> None:
    async with Server(acknowledges=False) as server:
        _, running = started(Role("fog"), server)
        await eventually(lambda: said(server) == [[b"up"]], "the birth")
        running.cancel()
        await eventually(lambda: said(server) == [[b"up", b"down"]], "the goodbye, which nobody acknowledges")
        running.cancel()
        await asyncio.wait({running}, timeout=10)
        assert running.cancelled()
        await eventually(lambda: said(server) == [[b"up", b"down", CLEAN]], "DISCONNECT")


def test_a_ready_file_that_can_nowhere_be_is_a_users_mistake(tmp_path: Path) -> None:
    missing = tmp_path / "none" / "ready"
    with pytest.raises(ConfigurationError) as error:
        Runner(Role(), SessionClock(), missing)
    assert str(error.value) == f"--ready-file {missing}: expected a file in a folder that exists"


@pytest.mark.long
@pytest.mark.parametrize("fault", [errno.EROFS, errno.ENOSPC, errno.EIO])
async def test_a_disk_that_takes_no_ready_file_ends_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: int
) -> None:
    def fail(path: Path, *_: object, **__: object) -> None:
        raise OSError(fault, os.strerror(fault))

    async with Server() as server:
        runner, running = started(Role("fog"), server, tmp_path / "ready")
        await eventually(lambda: (tmp_path / "ready").exists(), "the ready file")
        monkeypatch.setattr(Path, "touch", fail)
        monkeypatch.setattr(Path, "unlink", fail)
        await eventually(lambda: running.done() or runner.counts["ready_file"] > 0, "the fault")
        assert not running.done()
        running.cancel()
        await asyncio.wait({running})
        assert running.cancelled()
        assert runner.counts["ready_file"] >= 2
        await eventually(lambda: said(server) == [[b"up", b"down", CLEAN]], "the goodbye")


async def test_a_disk_that_takes_its_time_for_the_ready_file_holds_nothing_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_asked, goes_on = threading.Event(), threading.Event()

    def wait(path: Path) -> None:
        is_asked.set()
        goes_on.wait(10)

    monkeypatch.setattr(Path, "touch", wait)
    async with Server() as server:
        role = Role("fog")
        _, running = started(role, server, tmp_path / "ready")
        await eventually(is_asked.is_set, "the ready file is asked for")
        ticks = role.ticks
        await eventually(lambda: role.ticks > ticks + 3, "it ticks", 2)
        assert not goes_on.is_set()
        running.cancel()
        await eventually(lambda: said(server) == [[b"up", b"down", CLEAN]], "the goodbye")
        goes_on.set()
        await asyncio.wait({running})
        assert running.cancelled()


TAKES_LEAVE = """
import asyncio, signal
import typer
from mqttxt.cli.common import run_coroutine
signal.signal(signal.SIGINT, signal.default_int_handler)  # as in a terminal; in the background a shell has it ignored
async def job():
    print("begun", flush=True)
    try:
        await asyncio.Event().wait()
    finally:
        print("ended", flush=True)
typer.run(lambda: run_coroutine(job()))
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_command_that_is_ended_takes_leave(number: int, code: int) -> None:
    with subprocess.Popen([sys.executable, "-c", TAKES_LEAVE], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        process.send_signal(number)
        assert process.communicate()[0] == "ended\n"
    assert process.returncode == code


@given(st.floats(0, 1e6), st.floats(0, 60))
def test_the_next_tick_is_on_the_schedule_and_not_yet_past(due_s: float, late_s: float) -> None:
    now_s = due_s + late_s
    after = next_tick(due_s, now_s)
    ticks = (after - due_s) / TICK_S
    assert ticks == pytest.approx(round(ticks), abs=1e-6)
    assert round(ticks) >= 1
    assert now_s - 1e-6 <= after <= now_s + TICK_S + 1e-6


def test_a_tick_that_took_long_is_not_made_up_for_by_a_burst() -> None:
    assert next_tick(10.0, 10.001) == pytest.approx(10.05)
    assert next_tick(10.0, 10.26) == pytest.approx(10.30)
