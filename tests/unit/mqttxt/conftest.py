"""A disk that a test can fill, a group for the tasks of a gateway, a fleet, and a fog that signs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from mqttxt.security.authority import Authority
from tests.rigs.small_disk import SmallDisk
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
def acme(tmp_path: Path) -> Authority:
    return Authority.create(tmp_path / "acme", "acme")


@pytest.fixture
def world() -> World:
    return signed_world()
