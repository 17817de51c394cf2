"""The activator supervises its embedded Mosquitto: it comes back when it dies, and a taken port is one line."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import docker
import pytest
from processes import NODE_IMAGE, System, eventually, free_port, wait_until

from mqttxt import Arm, GroundStation, Outcome, Takeoff, Word

pytestmark = pytest.mark.integration

KILL_MOSQUITTO = """
import os, pathlib, signal
for found in pathlib.Path('/proc').glob('[0-9]*/comm'):
    if found.read_text().strip() == 'mosquitto':
        os.kill(int(found.parent.name), signal.SIGKILL)
        print('killed')
"""


class ContainedActivator:
    """`mqttxt activator` with its embedded broker, from the testbed's image, on loopback."""

    def __init__(self, cloud: str, port: int) -> None:
        self.port = port
        self._cloud = cloud
        self._container: Any = None

    def start(self) -> None:
        options = ["--fog", "1", "--cloud", self._cloud, "--listen", f"127.0.0.1:{self.port}", "--drones", "1,2"]
        self._container = docker.from_env().containers.run(
            NODE_IMAGE, ["mqttxt", "activator", *options], network_mode="host", init=True, detach=True
        )

    def kill_broker(self) -> None:
        code, output = self._container.exec_run(["python3", "-c", KILL_MOSQUITTO], user="1000:1000")
        assert (code, output) == (0, b"killed\n")

    def log(self) -> str:
        return str(self._container.logs().decode())

    def ended(self) -> int | None:
        self._container.reload()
        return int(self._container.attrs["State"]["ExitCode"]) if self._container.status == "exited" else None

    def kill(self) -> None:
        if self._container is not None:
            self._container.remove(force=True)


async def test_a_killed_embedded_broker_comes_back_in_mid_flight(tmp_path: Path) -> None:
    system = System(tmp_path)
    contained = ContainedActivator(system.cloud.url, free_port())
    system.uavs = {n: system.make_uav(n, f"mqtt://127.0.0.1:{contained.port}") for n in system.autopilots}
    try:
        system.cloud.start()
        contained.start()
        for process in (*system.sitls.values(), *system.uavs.values()):
            process.start()
        async with GroundStation(system.cloud.url) as station:
            (fog,) = await station.connect([1], timeout_s=30)
            await eventually(lambda: all(fog.drone(n).is_reachable for n in (1, 2)), "both drones reachable")
            async for outcome in fog.broadcast(Arm()):
                assert not outcome.is_last or outcome.word is Word.COMPLETED
            heard: list[Outcome] = []
            listening = asyncio.create_task(_collect(fog.broadcast(Takeoff(8)), heard))
            await eventually(lambda: len(heard) == 2, "takeoff accepted")
            await asyncio.to_thread(contained.kill_broker)
            await asyncio.wait_for(listening, 60)
            assert fog._view.broker == f"mqtt://127.0.0.1:{contained.port}"
        assert "embedded broker ended with code" in contained.log()
        assert sorted((o.drone, o.word) for o in heard if o.is_last) == [(1, Word.COMPLETED), (2, Word.COMPLETED)]
        assert [len(system.commanded(n, 22)) for n in (1, 2)] == [1, 1]
    finally:
        contained.kill()
        system.close()


def test_a_port_in_use_is_one_line(tmp_path: Path) -> None:
    system = System(tmp_path)
    system.cloud.start()
    contained = ContainedActivator(system.cloud.url, system.cloud.port)
    try:
        contained.start()
        wait_until(lambda: contained.ended() is not None, "the activator gives up")
        assert contained.ended() == 2
        (said,) = [line for line in contained.log().splitlines() if line.startswith("mqttxt: ")]
        assert f"embedded broker 127.0.0.1:{system.cloud.port}: Mosquitto ended with code" in said
        assert "Address already in use" in said
        assert "Traceback" not in contained.log()
    finally:
        contained.kill()
        system.close()


async def _collect(stream: Any, heard: list[Outcome]) -> None:
    async for outcome in stream:
        heard.append(outcome)
