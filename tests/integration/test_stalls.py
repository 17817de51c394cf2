"""Deadlines hold whatever stalls, delays, jumps or dies, with clocks that run differently: none late, none twice."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import Any

import pytest
import pytest_asyncio

from tests.rigs.flaky_link import FlakyLink
from tests.rigs.processes import System
from tests.rigs.salvo import FAST, SLOW, Salvo, all_reachable, aloft, station

pytestmark = [pytest.mark.integration, pytest.mark.asyncio(loop_scope="module")]

COMMANDS_PER_LEG = 120
STALL_S = 0.9
"""How long a leg stalls, and how long it flows between."""
JITTER_S = 0.2
PARTS = ("cloud broker", "fog broker", "activator", "uav clients")
LEGS = ("gs-cloud", "cloud-activator", "activator-fog", "fog-uav")


@dataclass
class Fleet:
    """A system with a link that can fail on every hop, its drones aloft."""

    system: System
    links: dict[str, FlakyLink]
    fog: Any
    salvo: Salvo

    def parts(self, leg: str) -> list[Any]:
        system = self.system
        named = {"cloud broker": [system.cloud], "fog broker": [system.fog], "activator": [system.activator]}
        named["uav clients"] = list(system.uavs.values())
        return named.get(leg) or [self.links[leg]]

    def anew(self) -> Salvo:
        self.salvo = self.salvo.anew()
        return self.salvo


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def fleet(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Fleet]:
    """The activator and a drone have slow clocks, the station and the other drone fast ones."""
    system = System(tmp_path_factory.mktemp("stalls"))
    links = {}
    try:
        for name in LEGS:
            port = system.cloud.port if name in ("gs-cloud", "cloud-activator") else system.fog.port
            links[name] = await FlakyLink(port).start()
        ends = links["cloud-activator"].url, links["activator-fog"].url
        system.activator = system.make_activator(*ends, ppm=SLOW)
        for drone, ppm in ((1, SLOW), (2, FAST)):
            system.uavs[drone] = system.make_uav(drone, links["fog-uav"].url, ppm=ppm)
        await asyncio.to_thread(system.start)
        async with station(links["gs-cloud"].url) as gs:
            (fog,) = await gs.connect([1])
            yield Fleet(system, links, fog, await aloft(system, fog))
    finally:
        system.close()
        for link in links.values():
            await link.close()


@contextlib.asynccontextmanager
async def again_and_again(act: Callable[[], Any], pause_s: float) -> AsyncIterator[None]:
    """Something that happens every now and then, until the block ends."""
    ending = asyncio.Event()

    async def going_on() -> None:
        while not ending.is_set():
            await asyncio.to_thread(act)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(pause_s):
                    await ending.wait()

    task = asyncio.create_task(going_on())
    try:
        yield
    finally:
        ending.set()
        await task


@pytest.mark.parametrize("leg", PARTS + LEGS)
async def test_no_command_is_executed_late_or_twice_while_a_leg_stalls(fleet: Fleet, leg: str) -> None:
    await all_reachable(fleet.fog)
    salvo, parts, stalled = fleet.anew(), fleet.parts(leg), False

    def toggle() -> None:
        nonlocal stalled
        stalled = not stalled
        for part in parts:
            part.stall() if stalled else part.go_on()

    async with again_and_again(toggle, STALL_S):
        await salvo.fire(fleet.fog, COMMANDS_PER_LEG)
    for part in parts:
        part.go_on()
    counts = salvo.verdict(f"{leg} stalls")
    assert counts["executed"] > 0
    assert counts["expired"] > 0


async def test_while_every_hop_delays(fleet: Fleet) -> None:
    """Four hops in order, each up to JITTER_S: about as long as a command is valid."""
    await all_reachable(fleet.fog)
    salvo = fleet.anew()
    for link in fleet.links.values():
        link.jitter_s = JITTER_S
    try:
        await salvo.fire(fleet.fog, COMMANDS_PER_LEG)
    finally:
        for link in fleet.links.values():
            link.jitter_s = 0.0
    counts = salvo.verdict("every hop delays")
    assert counts["executed"] > 0
    assert counts["expired"] > 0


@pytest.mark.parametrize("leg", PARTS)
async def test_while_a_part_is_killed_and_started_again(fleet: Fleet, leg: str) -> None:
    await all_reachable(fleet.fog)
    salvo = fleet.anew()

    def restart() -> None:
        for part in fleet.parts(leg):
            part.kill()
            part.start()

    async with again_and_again(restart, 4.0):
        await salvo.fire(fleet.fog, 2 * COMMANDS_PER_LEG)
    counts = salvo.verdict(f"{leg} killed and started again")
    assert counts["sent"] > 0


async def test_a_drones_clock_that_jumps_ahead_only_refuses(fleet: Fleet) -> None:
    """The last one: until the drone's next beacon the activator's deadlines are too early for it."""
    await all_reachable(fleet.fog)
    salvo = fleet.anew()
    async with again_and_again(fleet.system.uavs[1].step_clock, 1.0):
        await salvo.fire(fleet.fog, COMMANDS_PER_LEG)
    counts = salvo.verdict("drone 1's clock jumps ahead")
    assert counts["executed"] > 0
    assert counts["refused_in_time"] > 0
