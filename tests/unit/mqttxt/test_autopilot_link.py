"""The link to an autopilot: what waits is all read at once, and what a line does not take holds nobody up."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import socket
import termios
import tty
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, closing
from pathlib import Path
from typing import Any

import pytest
import serial
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.mavlink import link, transports
from mqttxt.drone.mavlink.link import AutopilotLink
from mqttxt.drone.mavlink.repeated_acks import Repeats
from mqttxt.drone.mavlink.transports import AutopilotAddress, Serial
from mqttxt.errors import ConfigurationError
from tests.rigs.link_bench import LinkBench
from tests.rigs.processes import eventually, free_port
from tests.simulation.world import ack, heartbeat

AUTOPILOT = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
HEARTBEAT, ACK = heartbeat().pack(AUTOPILOT), ack(400).pack(AUTOPILOT)


def numbered(message: Any, seq: int) -> bytes:
    """A message of the autopilot with a number of its own, as senders give them."""
    counting = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    counting.seq = seq
    return bytes(message.pack(counting))


def beat(seq: int) -> bytes:
    return numbered(heartbeat(), seq)


@asynccontextmanager
async def running(link: AutopilotLink) -> AsyncIterator[asyncio.Task[None]]:
    """Run a link while this is entered."""
    task = asyncio.create_task(link.run())
    try:
        yield task
    finally:
        task.cancel()
        await asyncio.wait({task})


@pytest.fixture
async def bench() -> AsyncIterator[LinkBench]:
    async with LinkBench().open() as made:
        yield made


@pytest.fixture
def pty() -> Iterator[tuple[int, int]]:
    """A line's two ends: theirs, and the device that is opened."""
    theirs, ours = os.openpty()
    yield theirs, ours
    os.close(ours)
    os.close(theirs)


@pytest.fixture
def device(pty: tuple[int, int]) -> str:
    return os.ttyname(pty[1])


def reached(bench: LinkBench) -> list[bool]:
    """Write one message; who of the sockets got it."""
    return [bool(frame) for frame in bench.write(heartbeat())]


async def test_two_bytes_of_noise_blind_nobody(bench: LinkBench) -> None:
    noise, autopilot = bench.socket(), bench.socket()
    for seq in range(50):
        noise.send(b"\xfd\xff")
        autopilot.send(beat(seq))
    await eventually(lambda: len(bench.heard) == 50, "every heartbeat")
    assert bench.refused


async def test_a_datagram_that_is_no_heartbeat_of_the_own_autopilot_takes_no_link(bench: LinkBench) -> None:
    other_system = mavlink.MAVLink(None, srcSystem=2, srcComponent=1)
    other_component = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    stranger, autopilot = bench.socket(), bench.socket()
    for data in (b"\0", HEARTBEAT[:-1], ACK, heartbeat().pack(other_system), heartbeat().pack(other_component)):
        await bench.say(stranger, data)
        assert reached(bench) == [False, False]
    before = len(bench.heard)
    autopilot.send(HEARTBEAT)
    await eventually(lambda: len(bench.heard) > before, "heard")
    assert reached(bench) == [False, True]


@pytest.mark.parametrize("kind", [mavlink.MAV_AUTOPILOT_INVALID, mavlink.MAV_AUTOPILOT_GENERIC])
async def test_who_beats_with_the_autopilots_numbers_and_is_none_takes_no_link(
    bench: LinkBench, monkeypatch: pytest.MonkeyPatch, kind: int
) -> None:
    autopilot, program = bench.socket(), bench.socket()
    program.send(mavlink.MAVLink_heartbeat_message(18, kind, 0, 0, 4, 3).pack(AUTOPILOT))
    await eventually(lambda: len(bench.heard) == 1, "heard")
    assert reached(bench) == [False, False]
    autopilot.send(beat(1))
    await eventually(lambda: len(bench.heard) == 2, "heard")
    assert reached(bench) == [True, False]
    monkeypatch.setattr(transports, "HEARTBEAT_LOST_MS", 0)  # its heartbeats stay away
    program.send(mavlink.MAVLink_heartbeat_message(18, kind, 0, 0, 4, 3).pack(AUTOPILOT))
    await eventually(lambda: len(bench.heard) == 3, "heard")
    assert reached(bench) == [True, False]


async def test_a_live_peer_keeps_the_link_and_is_alone_heard(bench: LinkBench, monkeypatch: pytest.MonkeyPatch) -> None:
    autopilot, forger = bench.socket(), bench.socket()
    autopilot.send(HEARTBEAT)
    await eventually(lambda: bench.heard == ["HEARTBEAT"], "heard")
    forger.send(HEARTBEAT)
    forger.send(ACK)
    await eventually(lambda: len(bench.refused) == 2, "refused")
    assert bench.heard == ["HEARTBEAT"]
    assert reached(bench) == [True, False]
    monkeypatch.setattr(transports, "HEARTBEAT_LOST_MS", 0)  # its heartbeats stay away: it may have a new port
    forger.send(beat(1))
    await eventually(lambda: len(bench.heard) == 2, "heard")
    assert reached(bench) == [False, True]


async def test_an_acknowledgement_behind_other_messages_is_heard_in_the_same_turn() -> None:
    """A tick in between would find it missing, and say the command again."""
    heard: list[str] = []
    held: list[list[str]] = []

    def on_readable() -> None:
        for message in link.messages():
            if not heard:
                asyncio.get_running_loop().call_soon(lambda: held.append(list(heard)))
            heard.append(message.get_type())

    port = free_port(socket.SOCK_DGRAM)
    link = AutopilotLink(
        AutopilotAddress("udp", "127.0.0.1", port), 1, on_readable, lambda found: heard.append(found.reason)
    )
    async with running(link):
        await eventually(lambda: link._transport is not None, "it listens")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for data in [*[beat(seq) for seq in range(100)], ACK]:
                sender.sendto(data, ("127.0.0.1", port))
        await eventually(lambda: held != [], "heard")
        assert held == [["HEARTBEAT"] * 100 + ["COMMAND_ACK"]]


class Flood(transports.Transport):
    """A transport on which there is always a message, each of which costs the reader `cost_s`."""

    def __init__(self, cost_s: float) -> None:
        super().__init__(None)
        self._cost_s, self._spent_s = cost_s, 0.0

    def time(self) -> float:
        return self._spent_s

    def read(self, now_s: float) -> transports.Read | None:
        self._spent_s += self._cost_s
        return transports.Read([heartbeat()])


@pytest.mark.parametrize(("cost_s", "read"), [(0.0, link._READS_AT_ONCE), (0.1, 6)])
async def test_a_flood_is_read_in_turns_that_leave_time_for_ticks(
    monkeypatch: pytest.MonkeyPatch, cost_s: float, read: int
) -> None:
    loop = asyncio.get_running_loop()
    flood = Flood(cost_s)
    flooded = AutopilotLink(AutopilotAddress("udp", "127.0.0.1", 1), 1, lambda: None, lambda _: None)
    flooded._transport = flood
    monkeypatch.setattr(loop, "time", flood.time)
    found = len(list(flooded.messages()))
    monkeypatch.undo()
    assert found == read


async def test_what_is_dropped_unread_keeps_the_peer(bench: LinkBench) -> None:
    """While the process stood still, the peer's heartbeats became old, and a stranger's may be the first to be read."""
    autopilot, stranger = bench.socket(), bench.socket()
    await bench.say(autopilot, HEARTBEAT)
    transport = bench.link._transport
    assert isinstance(transport, transports.Udp)
    transport._peer_heard_s -= 60
    stranger.send(HEARTBEAT)
    autopilot.send(HEARTBEAT)
    bench.link.discard()
    await bench.say(stranger, HEARTBEAT)
    assert reached(bench) == [True, False]


def test_a_device_that_takes_nothing_holds_nobody_up(pty: tuple[int, int], device: str) -> None:
    theirs, ours = pty
    tty.setraw(ours)
    with closing(Serial(AutopilotAddress("serial", device, 57600), lambda message, _: message)) as line:
        assert line.write(b"heartbeat")
        assert os.read(theirs, 100) == b"heartbeat"
        taken = 0
        while line.write(bytes(100)):  # nobody reads: the system's buffer fills
            taken += 100
        assert not line.write(b"heartbeat")
        while taken > 0:
            taken -= len(os.read(theirs, 4096))
        assert line.write(b"heartbeat")


def test_an_acknowledgement_that_the_link_doubled_is_heard_once() -> None:
    repeats = Repeats()

    def is_copy(seq: int, now_s: float) -> bool:
        return repeats.is_copy(mavlink.MAVLink(None).decode(bytearray(numbered(ack(400), seq))), now_s)

    heard = ((7, 0.0), (8, 0.1), (7, 2.9), (8, 3.0))
    assert [is_copy(seq, now_s) for seq, now_s in heard] == [False, False, True, True]
    assert not is_copy(7, 3.2)  # the number has gone round meanwhile
    assert len(repeats._heard_s) == 1


async def test_an_acknowledgement_that_comes_twice_over_the_link_is_heard_once(bench: LinkBench) -> None:
    autopilot = bench.socket()
    for datagram in (HEARTBEAT, ACK, ACK, beat(9)):
        autopilot.send(datagram)
    await eventually(lambda: bench.heard.count("HEARTBEAT") == 2, "what came last")
    assert bench.heard == ["HEARTBEAT", "COMMAND_ACK", "HEARTBEAT"]


async def test_heartbeats_of_one_number_are_all_heard(bench: LinkBench) -> None:
    """PX4 sends 451 messages a second to a companion computer: its numbers come again within a second."""
    autopilot = bench.socket()
    for _ in range(3):
        autopilot.send(beat(7))
    await eventually(lambda: len(bench.heard) == 3, "three heartbeats")


async def test_a_line_that_is_not_there_is_told_once_and_once_more_when_it_is(
    tmp_path: Path, device: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(link, "REOPEN_S", 0.01)
    tries = []

    async def counted(*arguments: Any) -> transports.Transport:
        tries.append(arguments)
        return await transports.open_transport(*arguments)

    monkeypatch.setattr(link, "open_transport", counted)
    line = tmp_path / "line"
    made = AutopilotLink(AutopilotAddress("serial", str(line), 57_600), 1, lambda: None, lambda _: None)
    async with running(made):
        await eventually(lambda: len(tries) >= 3, "it tries again")
        line.symlink_to(device)
        await eventually(lambda: made._transport is not None, "it is open")
        missing, there = [record.message for record in caplog.records if "autopilot serial" in record.message]
        assert missing.endswith("; trying until it opens")
        assert "No such file or directory" in missing
        assert there == f"autopilot serial:{line}:57600: the link is open"


@pytest.mark.parametrize("baud", [57_600, 123_456])
async def test_a_device_that_vanishes_while_it_is_opened_is_opened_again(
    baud: int, device: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """pyserial does not turn each of the system's errors into its own."""
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(link, "REOPEN_S", 0.01)
    gone = [True, True]

    def vanishing(raised: Exception) -> Any:
        def step(*_: Any) -> None:
            if gone:
                gone.pop()
                raise raised

        return step

    def at_an_uncommon_rate(*_: Any) -> None:
        try:
            vanishing(OSError(errno.EIO, os.strerror(errno.EIO)))()
        except OSError as error:
            raise ValueError(f"Failed to set custom baud rate ({baud}): {error}")  # noqa: B904 - as pyserial does

    monkeypatch.setattr(serial.Serial, "_reset_input_buffer", vanishing(termios.error(errno.EIO, "Input/output error")))
    if baud != 57_600:
        monkeypatch.setattr(serial.Serial, "_set_special_baudrate", at_an_uncommon_rate)
    made = AutopilotLink(AutopilotAddress("serial", device, baud), 1, lambda: None, lambda _: None)
    async with running(made) as task:
        await eventually(lambda: task.done() or made._transport is not None, "it is open")
        assert not task.done(), task
        assert gone == []
        assert caplog.text.count("Input/output error; trying until it opens") == 1


async def test_an_address_that_comes_later_is_told_once_and_listened_at(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A companion computer that starts anew in flight has its network a little later."""
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(link, "REOPEN_S", 0.01)
    tries = []

    async def later(address: AutopilotAddress, *more: Any) -> transports.Transport:
        tries.append(address)
        there = address if len(tries) < 4 else AutopilotAddress("udp", "127.0.0.1", 0)
        return await transports.open_transport(there, *more)

    monkeypatch.setattr(link, "open_transport", later)
    made = AutopilotLink(AutopilotAddress("udp", "192.0.2.7", 14_550), 1, lambda: None, lambda _: None)
    async with running(made) as task:
        await eventually(lambda: task.done() or made._transport is not None, "it listens")
        assert not task.done(), task
        assert [record.message for record in caplog.records if "autopilot udp" in record.message] == [
            "autopilot udp:192.0.2.7:14550: Cannot assign requested address; trying until it opens",
            "autopilot udp:192.0.2.7:14550: the link is open",
        ]


async def test_an_address_that_cannot_be_is_one_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        made = AutopilotLink(AutopilotAddress("udp", "127.0.0.1", port), 1, lambda: None, lambda _: None)
        with pytest.raises(
            ConfigurationError, match=f"^autopilot udp:127.0.0.1:{port}: cannot listen: Address already"
        ):
            await made.run()
