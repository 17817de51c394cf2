"""A UAV client whose disk fills, with real brokers: it says no, goes on, starts anew, and flies once there is room."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from mqttxt import Arm, Disarm, GroundStation, Word
from tests.rigs.processes import System, eventually

pytestmark = pytest.mark.integration

ARM_DISARM = 400


@pytest.fixture
def small(tmp_path: Path) -> Iterator[Path]:
    """A file system of 128 KiB."""
    folder = tmp_path / "small"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("no file system can be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(folder: Path) -> None:
    with contextlib.suppress(OSError), (folder / "filler").open("wb", buffering=0) as filler:
        while True:
            filler.write(bytes(512))


async def test_a_full_disk_denies_and_room_is_all_that_is_needed(tmp_path: Path, small: Path) -> None:
    system = System(tmp_path)
    options = ["--journal", str(small / "journal")]
    system.uavs[1] = uav = system.make_uav(1, system.fog.url).with_more(*options)
    try:
        await asyncio.to_thread(system.start)
        async with GroundStation(system.cloud.url) as station:
            (fog,) = await station.connect([1])
            drone = fog.drone(1)
            await eventually(lambda: drone.is_reachable and drone.is_controlled, "the drone is there")
            assert (await drone.arm()).completed

            fill(small)
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

            (small / "filler").unlink()
            assert (await drone.arm()).completed
        assert uav.exit_code is None
        log = uav.log.read_text()
        said = "No space left on device; commands other than hold, land and return are denied until it can be written"
        assert said in log
        assert "can be written again" in log
        assert "Traceback" not in log
    finally:
        system.close()
