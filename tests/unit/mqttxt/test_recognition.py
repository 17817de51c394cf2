"""Whose autopilot is on the link: a stray heartbeat of another system ends nobody."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.address import BrokerAddress
from mqttxt.core.hearing import STALL_MS
from mqttxt.core.settings import Settings
from mqttxt.drone.journal import JournalFile
from mqttxt.drone.mavlink.transports import AutopilotAddress, Udp
from mqttxt.drone.process import UavRunner
from mqttxt.drone.recognition import GAP_MS, PATIENCE_MS, Recognition
from mqttxt.errors import ConfigurationError
from tests.rigs.processes import eventually
from tests.simulation.world import from_autopilot


def beats(recognition: Recognition, system_id: int, start_ms: int, end_ms: int, gap_ms: int = 1000) -> list[int | None]:
    return [recognition.on_heartbeat(system_id, now) for now in range(start_ms, end_ms, gap_ms)]


def test_an_unknown_kind_that_keeps_coming_is_the_links() -> None:
    recognition, said = Recognition(7), []
    for now_ms in range(0, PATIENCE_MS + 1, 1000):
        recognition.on_own()
        said.append(recognition.on_heartbeat(7, now_ms, is_known=False))
    assert (set(said[:-1]), said[-1]) == ({None}, 7)


def test_another_autopilot_whose_heartbeat_keeps_coming_is_the_links() -> None:
    said = beats(Recognition(7), 9, 0, PATIENCE_MS + 1)
    assert (set(said[:-1]), said[-1]) == ({None}, 9)


def test_one_that_comes_and_goes_is_not() -> None:
    assert set(beats(Recognition(7), 9, 0, 10 * PATIENCE_MS, GAP_MS + 1)) == {None}


def test_others_share_a_link_with_the_own_system() -> None:
    recognition = Recognition(7)
    for start in range(0, 5 * PATIENCE_MS, PATIENCE_MS - 1000):
        assert set(beats(recognition, 9, start, start + PATIENCE_MS - 1000)) == {None}
        recognition.on_own()


PX4, GENERIC, INVALID = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_GENERIC, mavlink.MAV_AUTOPILOT_INVALID


class Client:
    """The UAV client of drone 7 as a process, in a time of its own; heartbeats come as its link hands them on."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.journal = JournalFile(folder / "drone7.journal")
        nowhere, autopilot = BrokerAddress.parse("mqtt://127.0.0.1:1"), AutopilotAddress("udp", "127.0.0.1", 0)
        self.runner = UavRunner(7, nowhere, autopilot, self.journal, Settings())
        self.now_ms = self.runner.clock.now_ms()
        patch.setattr(self.runner.clock, "now_ms", lambda: self.now_ms)
        self.patch = patch
        self.running = asyncio.create_task(self.runner.run())

    def hear(self, autopilot: int, system: int = 7) -> None:
        heartbeat = from_autopilot(mavlink.MAVLink_heartbeat_message(2, autopilot, 1, 0, 4, 3), system)
        self.patch.setattr(self.runner._autopilot, "messages", lambda: [heartbeat])
        self.runner.ticked_ms = self.now_ms
        self.runner._on_readable()

    def keep_hearing(self, autopilot: int, system: int = 7) -> None:
        for _ in range(0, PATIENCE_MS + 1, 1000):
            self.hear(autopilot, system)
            self.now_ms += 1000


@pytest.fixture
async def client(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Client]:
    made = Client(tmp_path, monkeypatch)
    await eventually(lambda: made.runner._autopilot._transport is not None, "it listens")
    yield made
    made.running.cancel()
    await asyncio.wait({made.running})
    made.journal.close()


@pytest.mark.parametrize(("autopilot", "system"), [(GENERIC, 7), (INVALID, 7), (PX4, 9)])
async def test_a_process_ends_by_no_stray_heartbeat_and_knows_its_own(
    client: Client, caplog: pytest.LogCaptureFixture, autopilot: int, system: int
) -> None:
    caplog.set_level("INFO")
    client.hear(autopilot, system)
    assert not client.runner._heard.is_set()
    client.now_ms += PATIENCE_MS + 1
    client.hear(autopilot, system)
    client.hear(PX4)
    await eventually(lambda: client.running.done() or "drone 7: heard its autopilot" in caplog.text, "it is known")
    assert not client.running.done()


@pytest.mark.parametrize(
    ("autopilot", "system", "why"),
    [(GENERIC, 7, "HEARTBEAT.autopilot is 0, its type 2"), (PX4, 9, "has MAVLink system id 9; expected 7")],
)
async def test_a_process_ends_where_such_heartbeats_keep_coming(
    client: Client, autopilot: int, system: int, why: str
) -> None:
    client.keep_hearing(autopilot, system)
    await eventually(client.running.done, "the end")
    found = client.running.exception()
    assert isinstance(found, ConfigurationError)
    assert why in str(found)


async def test_what_is_no_autopilot_may_keep_coming(client: Client) -> None:
    client.keep_hearing(INVALID)
    assert not client.runner._heard.is_set()


async def test_what_waited_while_the_process_stood_still_is_no_sign_of_life(client: Client) -> None:
    beat = mavlink.MAVLink_heartbeat_message(2, PX4, 1, 0, 4, 3).pack(
        mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    )
    at = client.runner._autopilot._transport
    assert isinstance(at, Udp)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        autopilot.sendto(beat, at._socket.getsockname())
        client.now_ms += STALL_MS + 1
        await eventually(lambda: client.runner.ticked_ms == client.now_ms, "it ticks again")
        assert client.runner.client.vehicle.heartbeat_ms is None
        autopilot.sendto(beat, at._socket.getsockname())
        await eventually(lambda: client.runner.client.vehicle.heartbeat_ms is not None, "the next one counts")
