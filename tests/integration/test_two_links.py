"""Two links of each drone to a real broker, cut and stalled one at a time, or both (docs/protocol.md, section 19)."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from mqttxt import Drone, Word
from tests.integration.test_secure_fleet import SecureSystem
from tests.rigs.processes import Process, Proxy, System, eventually
from tests.rigs.salvo import Salvo, all_reachable, aloft, station

pytestmark = [pytest.mark.integration, pytest.mark.asyncio(loop_scope="module")]

CUTS = 20
STUCK_S = 1.5
NOT_STARTED = {Word.EXPIRED, Word.UNREACHABLE, Word.UNCONFIRMED, Word.OVERTAKEN}


@dataclass
class Fleet:
    """A system whose drones reach the fog's broker by two proxies, and are aloft."""

    system: System
    links: tuple[Proxy, Proxy]
    fog: Any
    salvo: Salvo


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def fleet(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Fleet]:
    system = System(tmp_path_factory.mktemp("links"))
    links = await Proxy(system.fog.port).start(), await Proxy(system.fog.port).start()
    try:
        for uav in system.uavs.values():
            uav.kill()
        for drone in (1, 2):
            system.uavs[drone] = system.make_uav(drone, links[0].url, None, None, "--broker", links[1].url)
        await asyncio.to_thread(system.start)
        async with station(system.cloud.url) as gs:
            (fog,) = await gs.connect([1])
            yield Fleet(system, links, fog, await aloft(system, fog))
    finally:
        system.close()
        for proxy in links:
            await proxy.close()


@contextlib.asynccontextmanager
async def broken(link: Proxy, is_stuck: bool) -> AsyncIterator[None]:
    """A link that is stuck for a while, or that ends and comes back at once."""
    if is_stuck:
        link.stall()
    else:
        link.cut()
    try:
        yield
    finally:
        link.go_on()


@contextlib.asynccontextmanager
async def broken_alone(link: Proxy, number: int, uavs: list[Process]) -> AsyncIterator[None]:
    """Of a client's two links one ends, or is stuck for so long that it is left; afterwards both are up."""
    is_stuck, name = number % 4 < 2, f"fog-{number % 2 + 1}"
    before = [uav.said().count(f"{name}: up") for uav in uavs]
    async with broken(link, is_stuck):
        yield
        if is_stuck:
            await asyncio.sleep(STUCK_S)
            return
    back = zip(uavs, before, strict=True)
    await asyncio.gather(*(eventually(partial(_is_up, uav, name, count), f"{name} is up") for uav, count in back))


def _is_up(uav: Process, name: str, before: int) -> bool:
    return uav.said().count(f"{name}: up") > before


@contextlib.asynccontextmanager
async def watched(*drones: Drone) -> AsyncIterator[list[int]]:
    """Drones that a station called unreachable meanwhile."""
    lost: list[int] = []

    async def watch() -> None:
        while True:
            lost.extend(drone.number for drone in drones if not drone.is_reachable)
            await asyncio.sleep(0.02)

    task = asyncio.create_task(watch())
    try:
        yield lost
    finally:
        task.cancel()


async def test_no_command_is_lost_and_no_drone_while_one_link_at_a_time_is_broken(fleet: Fleet) -> None:
    await all_reachable(fleet.fog)
    drones = [fleet.fog.drone(number) for number in (1, 2)]
    async with watched(*drones) as lost:
        for number in range(CUTS):
            async with broken_alone(fleet.links[number % 2], number, [*fleet.system.uavs.values()]):
                place = fleet.salvo.next_x / 1e7, fleet.salvo.y, 5
                commands = [drone.hold(ttl_s=10) if number % 3 else drone.goto(*place, ttl_s=10) for drone in drones]
                words = [outcome.word for outcome in await asyncio.gather(*commands)]
                assert not NOT_STARTED & set(words), f"cut {number}: {words}"
            assert lost == [], f"cut {number}"
    assert all("goes on over" in uav.said() for uav in fleet.system.uavs.values())


async def test_none_is_late_or_twice_while_links_break_again_and_again(fleet: Fleet) -> None:
    await all_reachable(fleet.fog)
    salvo = replace(fleet.salvo, sent=[], unsent=0)
    ending = asyncio.Event()

    async def breaking() -> None:
        number = 0
        while not ending.is_set():
            async with broken(fleet.links[number % 2], is_stuck=number % 4 < 2):
                await asyncio.sleep(0.8)
            await asyncio.sleep(0.8)
            number += 1

    task = asyncio.create_task(breaking())
    await salvo.fire(fleet.fog, 240)
    ending.set()
    await task
    assert salvo.verdict("two links")["executed"] > 0


async def test_where_both_links_were_broken_everything_resumes(fleet: Fleet) -> None:
    await all_reachable(fleet.fog)
    for link in fleet.links:
        link.stall()
        link.cut()
    await eventually(lambda: not fleet.fog.drone(1).is_reachable, "drone 1 is gone with its last link")
    for link in fleet.links:
        link.go_on()
    await all_reachable(fleet.fog)
    assert (await fleet.fog.drone(1).hold(ttl_s=10)).completed


async def test_a_fleet_that_signs_has_two_links_by_one_identity(tmp_path: Path) -> None:
    """Two connections, one entry of the access list, and every message signed as over one link."""
    links = await Proxy(0).start(), await Proxy(0).start()
    urls = links[0].url.replace("mqtt:", "mqtts:"), links[1].url.replace("mqtt:", "mqtts:")
    system = SecureSystem(tmp_path, signed=True, links=urls)
    for link in links:
        link.target_port = system.brokers["broker-fog1"].port
    try:
        await asyncio.to_thread(system.start)
        async with system.station(signed=True) as gs:
            (fog,) = await gs.connect([1])
            drone = fog.drone(1)
            await eventually(lambda: drone.is_reachable and drone.is_controlled, "drone 1 is reachable and controlled")
            async with watched(drone) as lost:
                for number in range(8):
                    async with broken_alone(links[number % 2], number, [system.processes[2]]):
                        outcome = await (drone.arm(ttl_s=10) if number % 2 else drone.hold(ttl_s=10))
                        assert outcome.word not in NOT_STARTED
                        assert outcome.signer == "drone1"
                    assert lost == []
    finally:
        await asyncio.to_thread(system.close)
        for link in links:
            await link.close()
