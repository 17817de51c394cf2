"""A drone with two connections, with real brokers, processes and links that fail (docs/protocol.md, section 19)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Drone, Word
from mqttxt.security.authority import Authority
from mqttxt_conformance.relay import DOWN, UP
from tests.rigs.one_drone import SIGNED, TLS
from tests.rigs.processes import eventually
from tests.rigs.two_links import TwoLinkSystem, Watch

pytestmark = [pytest.mark.integration, pytest.mark.apart]
LINKS = pytest.mark.soak("services/mqttxt/src/mqttxt/core", "services/mqttxt/src/mqttxt/activator/drones.py")

TAKEOFF = mavlink.MAV_CMD_NAV_TAKEOFF
GONE_S = 3.0
"""A will, and what the activator waits behind it."""


@asynccontextmanager
async def flying(folder: Path, mode: str = "", **how: Any) -> AsyncIterator[tuple[TwoLinkSystem, Drone, Watch]]:
    """The system, its drone 1, which a station controls, and what that hears: no second last word."""
    system = TwoLinkSystem(folder, mode, **how)
    async with system.flying() as (station, drone):
        watch = Watch(station)
        yield system, drone, watch
        assert watch.doubled == []


async def up_and_down(system: TwoLinkSystem, drone: Drone) -> None:
    """Arm and disarm: the autopilot does each once, in this order, and nothing that came earlier."""
    before = system.turns()
    assert (await drone.arm()).completed
    assert (await drone.disarm()).completed
    assert system.turns() == [*before, "armed", "disarmed"]


@pytest.mark.parametrize("mode", [pytest.param("", marks=LINKS), pytest.param(TLS, marks=LINKS), SIGNED])
async def test_a_link_that_is_cut_or_held_up_either_way_holds_up_no_command(tmp_path: Path, mode: str) -> None:
    async with flying(tmp_path, mode) as (system, drone, watch):
        for number, link in enumerate(system.links, start=1):
            for ways in ((UP, DOWN), (UP,), (DOWN,)):
                link.stall(*ways)
                await up_and_down(system, drone)
                link.go_on()
                await up_and_down(system, drone)
            before = system.connections(number)
            link.cut()
            await up_and_down(system, drone)
            link.go_on()
            await system.connected_again(number, before)
        await up_and_down(system, drone)
        assert watch.losses == []


@pytest.mark.parametrize("dead", [pytest.param(0, marks=LINKS), 1])
async def test_a_dead_broker_holds_up_no_command(tmp_path: Path, dead: int) -> None:
    async with flying(tmp_path) as (system, drone, watch):
        broker = (system.fog, system.second)[dead]
        assert (await drone.arm()).completed
        broker.kill()
        assert (await drone.takeoff(5.0)).completed
        broker.start()
        assert (await drone.land()).completed
        assert system.commanded(TAKEOFF) == 1
        assert watch.losses == []


@pytest.mark.parametrize("mode", ["", SIGNED])
async def test_two_addresses_of_one_broker_are_two_links(tmp_path: Path, mode: str) -> None:
    """Neither a takeover nor a will makes the drone unreachable while one of them is up."""
    async with flying(tmp_path, mode, one_broker=True) as (system, drone, watch):
        for number, link in enumerate(system.links, start=1):
            before = system.connections(number)
            link.cut()
            await up_and_down(system, drone)
            link.go_on()
            await system.connected_again(number, before)
            await up_and_down(system, drone)
        assert watch.losses == []
        for link in system.links:
            link.cut()
        await eventually(lambda: watch.losses, "both links are cut", limit_s=GONE_S)


async def test_a_second_broker_of_another_fleet_costs_nothing_but_a_line(tmp_path: Path) -> None:
    other = Authority.create(tmp_path / "other", "other")
    async with flying(tmp_path, TLS, second_of=other) as (system, drone, watch):
        await up_and_down(system, drone)
        assert system.connections(2) == 0
        assert f"fog: mqtts://127.0.0.1:{system.links[1].port}: " in system.uav.said()
        assert watch.losses == []


async def test_both_links_cut_and_back(tmp_path: Path) -> None:
    """What is sent meanwhile is never flown; it is unconfirmed where a broker took it before it noticed the cut."""
    async with flying(tmp_path) as (system, drone, watch):
        before = [system.connections(number) for number in (1, 2)]
        addresses = [f"mqtt://127.0.0.1:{link.port}" for link in system.links]
        system.links[0].cut()
        lost = f"fog: one of two connections is lost; {addresses[1]} carries all"
        await eventually(lambda: lost in system.uav.said(), "the log says so")
        system.links[1].cut()
        meanwhile = await drone.arm(ttl_s=1)
        assert meanwhile.word in (Word.UNREACHABLE, Word.EXPIRED, Word.UNCONFIRMED)
        await eventually(lambda: watch.losses, "the drone is gone", limit_s=GONE_S)
        for link in system.links:
            link.go_on()
        for number in (1, 2):
            await system.connected_again(number, before[number - 1])
        await eventually(lambda: drone.is_reachable, "the drone is there again")
        await eventually(lambda: "fog: both connections are up" in system.uav.said().rpartition(lost)[2], "it says so")
        assert system.turns() == []
        await up_and_down(system, drone)


async def test_a_second_broker_that_comes_up_late_is_a_second_link(tmp_path: Path) -> None:
    async with flying(tmp_path, has_second=False) as (system, drone, watch):
        await up_and_down(system, drone)
        system.second.start()
        await system.connected_again(2, 0)
        connected = f"fog: connected to mqtt://127.0.0.1:{system.second.port} after "
        await eventually(lambda: connected in system.activator.said(), "the activator has it too")
        system.links[0].cut()
        await up_and_down(system, drone)
        assert watch.losses == []


async def test_a_second_broker_without_the_activator_carries_nothing(tmp_path: Path) -> None:
    """A wrong second address, which is the quicker one."""
    async with flying(tmp_path, knows_second=False) as (system, drone, watch):
        system.links[0].one_way_s = 0.2
        before = system.links[0].carried[UP]
        await up_and_down(system, drone)
        await eventually(lambda: drone.states, "states come")
        assert system.in_use() == 1
        assert system.links[0].carried[UP] > before
        assert watch.losses == []


async def test_a_clock_that_jumps_makes_no_command_late_or_doubled(tmp_path: Path) -> None:
    async with flying(tmp_path, ppm=200) as (system, drone, watch):
        for link in system.links:
            link.stall()
            before = system.turns().count("armed")
            outcome = asyncio.ensure_future(drone.arm(ttl_s=5))
            system.uav.step_clock()
            word = (await outcome).word
            link.go_on()
            assert word in (Word.COMPLETED, Word.EXPIRED, Word.DENIED)
            assert system.turns().count("armed") <= before + 1
            while not (await drone.disarm()).completed:
                pass  # by the clock that jumped the autopilot is silent, until its next heartbeat
            await up_and_down(system, drone)
        assert watch.losses == []


async def flap(system: TwoLinkSystem, drone: Drone, times: int) -> None:
    """The links take turns while commands are sent: one is down for half a second, the next once that is up again."""
    done = asyncio.Event()

    async def break_links() -> None:
        for turn in range(times):
            number = 1 + turn % 2
            before = system.connections(number)
            system.links[number - 1].cut()
            await asyncio.sleep(0.5)
            system.links[number - 1].go_on()
            await system.connected_again(number, before)
            await asyncio.sleep(0.3)
        done.set()

    async with asyncio.TaskGroup() as both:
        both.create_task(break_links())
        while not done.is_set():
            await up_and_down(system, drone)


async def test_links_that_flap(tmp_path: Path) -> None:
    async with flying(tmp_path) as (system, drone, _):
        await flap(system, drone, times=8)


@LINKS
@pytest.mark.timeout(400)
@pytest.mark.parametrize("mode", ["", SIGNED])
async def test_links_that_flap_for_a_minute(tmp_path: Path, mode: str) -> None:
    async with flying(tmp_path, mode) as (system, drone, _):
        await flap(system, drone, times=60)
