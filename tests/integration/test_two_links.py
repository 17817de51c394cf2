"""A drone with two connections, with real brokers and processes (docs/protocol.md, section 19)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Drone, GroundStation
from tests.rigs.processes import Broker, Proxy, System, eventually

pytestmark = [pytest.mark.integration, pytest.mark.apart]


@dataclass
class Rig:
    """Drone 1 reaches two brokers of the fog, each by a link of its own."""

    system: System
    drone: Drone
    brokers: tuple[Broker, Broker]
    links: tuple[Proxy, Proxy]


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[Rig]:
    system, second = System(tmp_path), Broker(tmp_path, "second")
    links = await Proxy(system.fog.port).start(), await Proxy(second.port).start()
    system.activator.with_more("--second-fog-broker", second.url)
    system.uavs[1] = system.make_uav(1, links[0].url).with_more("--second-broker", links[1].url)
    second.start()
    try:
        await asyncio.to_thread(system.start)
        async with GroundStation(system.cloud.url) as station:
            (fog,) = await station.connect([1])
            drone = fog.drone(1)
            await eventually(lambda: drone.is_reachable, "drone 1 is reachable")
            yield Rig(system, drone, (system.fog, second), links)
    finally:
        system.close()
        second.kill()
        for link in links:
            await link.close()


@pytest.mark.parametrize("stuck", [0, 1])
async def test_a_stuck_link_holds_up_no_command(rig: Rig, stuck: int) -> None:
    rig.links[stuck].stall()
    assert (await rig.drone.arm()).completed
    assert (await rig.drone.takeoff(5.0)).completed
    rig.links[stuck].go_on()
    assert (await rig.drone.hold()).completed
    assert rig.drone.is_reachable
    assert len(rig.system.commanded(1, mavlink.MAV_CMD_NAV_TAKEOFF)) == 1


@pytest.mark.parametrize("dead", [0, 1])
async def test_a_dead_broker_holds_up_no_command(rig: Rig, dead: int) -> None:
    assert (await rig.drone.arm()).completed
    rig.brokers[dead].kill()
    assert (await rig.drone.takeoff(5.0)).completed
    assert rig.drone.is_reachable
    rig.brokers[dead].start()
    assert (await rig.drone.land()).completed
    assert len(rig.system.commanded(1, mavlink.MAV_CMD_NAV_TAKEOFF)) == 1
