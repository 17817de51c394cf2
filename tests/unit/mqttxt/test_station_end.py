"""What waits for a ground station hears of its end, and leaves nothing behind."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from io import StringIO

import pytest
from rich.console import Console

from mqttxt import BrokerRefused, Event, GroundStation, StationEnded, TransferFailed
from mqttxt.cli.watch import watch_fogs
from mqttxt.protocol.plans import PLAN
from mqttxt.station.transfers import Staging
from tests.rigs.mqtt_server import Server
from tests.rigs.processes import eventually

TAKEN_OVER = b"\xe0\x02\x8e\x00"


async def _all(events: AsyncIterator[Event]) -> list[Event]:
    return [event async for event in events]


async def test_who_listens_or_waits_is_told_that_the_station_was_left() -> None:
    async with Server() as server:
        async with GroundStation(f"mqtt://127.0.0.1:{server.port}") as station:
            listening = asyncio.create_task(_all(station.events()))
            waiting = asyncio.create_task(station.wait_until(lambda: False, 3600))
            await eventually(lambda: station._runner.station.connected, "connected")
        await asyncio.wait({listening, waiting}, timeout=10)
        assert listening.result() == []
        with pytest.raises(StationEnded):
            waiting.result()


async def test_who_listens_is_told_what_ended_the_station() -> None:
    async with Server() as server:
        station = GroundStation(f"mqtt://127.0.0.1:{server.port}")
        await station.__aenter__()
        listening = asyncio.create_task(_all(station.events()))
        await eventually(lambda: station._runner.station.connected, "connected")
        server.sessions[0].send(TAKEN_OVER)
        await asyncio.wait({listening}, timeout=10)
        with pytest.raises(BrokerRefused, match="took over"):
            listening.result()
        with pytest.raises(BrokerRefused, match="took over"):
            await station.wait_until(lambda: False, 10)
        with pytest.raises(BrokerRefused, match="took over"):
            await station.__aexit__(None, None, None)


async def test_listening_no_longer_leaves_no_task_behind() -> None:
    async with Server() as server, GroundStation(f"mqtt://127.0.0.1:{server.port}") as station:
        await eventually(lambda: station._runner.station.connected, "connected")
        before = asyncio.all_tasks()
        listening = asyncio.create_task(_all(station.events()))
        await asyncio.sleep(0)
        listening.cancel()
        await asyncio.wait({listening}, timeout=10)
        await asyncio.sleep(0)
        assert asyncio.all_tasks() == before


@pytest.mark.timeout(20)
async def test_an_object_whose_way_nobody_follows_leaves_the_station_its_time() -> None:
    async with Server() as server, GroundStation(f"mqtt://127.0.0.1:{server.port}") as station:
        runner = station._runner
        runner.carry_out(runner.station.add_fogs([1]))
        with pytest.raises(TransferFailed, match="not within"):
            await runner.transfer(Staging(runner.station.fog(1), 1, PLAN, b"plan"), 0.2)


@pytest.mark.timeout(20)
async def test_a_timeout_of_who_follows_a_transfer_is_the_followers_own() -> None:
    async def follow() -> None:
        raise TimeoutError("the caller's")

    async with Server() as server, GroundStation(f"mqtt://127.0.0.1:{server.port}") as station:
        runner = station._runner
        runner.carry_out(runner.station.add_fogs([1]))
        with pytest.raises(TimeoutError, match="the caller's"):
            await runner.transfer(Staging(runner.station.fog(1), 1, PLAN, b"plan"), None, follow)


@pytest.mark.timeout(20)
async def test_the_live_table_ends_with_its_station() -> None:
    async with Server() as server:
        station = GroundStation(f"mqtt://127.0.0.1:{server.port}")
        await station.__aenter__()
        await eventually(lambda: station._runner.station.connected, "connected")
        watching = asyncio.create_task(watch_fogs(station, [], Console(file=StringIO(), force_terminal=True)))
        await asyncio.sleep(0)
        server.sessions[0].send(TAKEN_OVER)
        await asyncio.wait({watching}, timeout=10)
        assert watching.done()
        with pytest.raises(BrokerRefused, match="took over"):
            watching.result()
        with pytest.raises(BrokerRefused, match="took over"):
            await station.__aexit__(None, None, None)
