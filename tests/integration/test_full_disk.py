"""A UAV client whose disk fills, with real brokers: it says no, goes on, starts anew, and flies once there is room."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from mqttxt import Arm, Disarm, GroundStation, Word
from tests.rigs.commanding import controlled
from tests.rigs.processes import System, eventually
from tests.rigs.small_disk import SmallDisk

pytestmark = pytest.mark.integration

ARM_DISARM = 400


@pytest.fixture
def small(tmp_path: Path) -> Iterator[SmallDisk]:
    folder = tmp_path / "small"
    folder.mkdir()
    with closing(SmallDisk(folder)) as disk:
        if not disk.is_mounted:
            pytest.skip("no file system can be mounted here")
        yield disk


async def test_a_full_disk_denies_and_room_is_all_that_is_needed(tmp_path: Path, small: SmallDisk) -> None:
    system = System(tmp_path)
    options = ["--journal", str(small.folder / "journal")]
    system.uavs[1] = uav = system.make_uav(1, system.fog.url).with_more(*options)
    try:
        await asyncio.to_thread(system.start)
        async with GroundStation(system.cloud.url) as station:
            drone = await controlled(station)
            assert (await drone.arm()).completed

            small.fill()
            said = [await drone.send(Disarm()) for _ in range(40)]
            assert [(one.word, one.reason) for one in said[-3:]] == [(Word.DENIED, "journal")] * 3
            executed = [one for one in said if one.word is not Word.DENIED]
            assert len(system.commanded(1, ARM_DISARM)) == 1 + len(executed)

            await asyncio.to_thread(uav.kill)
            await eventually(lambda: not drone.is_reachable, "its client is gone")
            await asyncio.to_thread(uav.start().wait_ready)
            await eventually(lambda: drone.is_reachable and drone.is_controlled, "it is back, on a full disk")
            await eventually(lambda: "battery" in drone.states, "states flow")
            before = len(system.commanded(1, ARM_DISARM))
            assert ((last := await drone.send(Arm())).word, last.reason) == (Word.DENIED, "journal")
            assert len(system.commanded(1, ARM_DISARM)) == before

            small.make_room()
            assert (await drone.arm()).completed
        assert uav.exit_code is None
        log = uav.log.read_text()
        said = "No space left on device; commands other than hold, land and return are denied until it can be written"
        assert said in log
        assert "can be written again" in log
        assert "Traceback" not in log
    finally:
        system.close()
