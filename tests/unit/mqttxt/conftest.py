"""A disk that a test can fill, a gateway's desk with its tasks and a client, an air leg, a fleet, a fog that signs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from mqttxt.gateway.clients import Client
from mqttxt.security.authority import Authority
from tests.rigs.small_disk import SmallDisk
from tests.simulation.air_bench import AirBench, BenchClient
from tests.simulation.desk import Bench
from tests.simulation.signed import signed_world
from tests.simulation.world import World


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[SmallDisk]:
    folder = tmp_path / "small"
    folder.mkdir()
    with closing(SmallDisk(folder)) as small:
        yield small


@pytest.fixture
async def group() -> AsyncIterator[asyncio.TaskGroup]:
    async with asyncio.TaskGroup() as made:
        yield made
        for task in list(made._tasks):
            task.cancel()


@pytest.fixture
def bench(group: asyncio.TaskGroup) -> Bench:
    """A gateway's desk with one armed drone."""
    return Bench(group)


@pytest.fixture
def client(bench: Bench) -> Client:
    """A client of the desk, which has sent a HEARTBEAT."""
    return bench.client()


@pytest.fixture
def air() -> AirBench:
    """Both ends of an air leg by datagrams."""
    return AirBench()


@pytest.fixture
def uav(air: AirBench) -> BenchClient:
    """A UAV client that is connected to its gateway by datagrams."""
    return air.up()


@pytest.fixture
def acme(tmp_path: Path) -> Authority:
    return Authority.create(tmp_path / "acme", "acme")


@pytest.fixture
def world() -> World:
    return signed_world()
