"""Deadlines hold whatever stalls: over a thousand commands, none is executed late or twice."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import pytest
from processes import Proxy, System, eventually

from mqttxt import Arm, Goto, GroundStation, Takeoff, Word

pytestmark = pytest.mark.integration

MAV_CMD_DO_REPOSITION = 192
COMMANDS_PER_LEG = 130
PACE_S = 0.03
TTL_S = 0.6
STALL_S, FLOW_S = 1.1, 0.7
LEGS = (
    "cloud broker",
    "fog broker",
    "activator",
    "uav clients",
    "gs-cloud",
    "cloud-activator",
    "activator-fog",
    "fog-uav",
)


class Staller(Protocol):
    """Whatever can be held and let go."""

    def stall(self) -> None: ...
    def go_on(self) -> None: ...


@dataclass
class Sent:
    """A command that was sent: when at the latest it may be executed, and what became of it."""

    drone: int
    x: int
    latest_ns: int
    words: list[Word] = field(default_factory=list)


@contextlib.asynccontextmanager
async def stalling(leg: str, folder: Path) -> AsyncIterator[tuple[System, str, list[Any]]]:
    """A system whose `leg` can be stalled: (system, the ground station's broker, what stalls)."""
    system = System(folder)
    proxies: dict[str, Proxy] = {}
    try:
        for name, port in (("gs-cloud", system.cloud.port), ("cloud-activator", system.cloud.port)):
            proxies[name] = await Proxy(port).start()
        for name in ("activator-fog", "fog-uav"):
            proxies[name] = await Proxy(system.fog.port).start()
        system.activator = system.make_activator(proxies["cloud-activator"].url, proxies["activator-fog"].url)
        system.uavs = {drone: system.make_uav(drone, proxies["fog-uav"].url) for drone in system.autopilots}
        await asyncio.to_thread(system.start)
        stallers: dict[str, list[Any]] = {
            "cloud broker": [system.cloud],
            "fog broker": [system.fog],
            "activator": [system.activator],
            "uav clients": list(system.uavs.values()),
            **{name: [proxy] for name, proxy in proxies.items()},
        }
        yield system, proxies["gs-cloud"].url, stallers[leg]
    finally:
        system.close()
        for proxy in proxies.values():
            await proxy.close()


@pytest.mark.parametrize("leg", LEGS)
async def test_no_command_is_executed_late_or_twice_while_a_leg_stalls(leg: str, tmp_path: Path) -> None:
    async with stalling(leg, tmp_path) as (system, url, stallers), GroundStation(url) as station:
        (fog,) = await station.connect([1])
        await eventually(lambda: all(fog.drone(d).is_reachable for d in (1, 2)), "both drones reachable")
        await asyncio.gather(*(_fly_up(fog.drone(drone)) for drone in (1, 2)))

        ending = asyncio.Event()
        stalls = asyncio.create_task(_stall_now_and_then(stallers, ending))
        sent = await _send_many(system, fog)
        ending.set()
        await stalls

        assert all(sum(word.is_last for word in command.words) == 1 for command in sent), Counter(
            tuple(command.words) for command in sent
        )
        executed = {drone: system.commanded(drone, MAV_CMD_DO_REPOSITION) for drone in (1, 2)}
        _assert_in_time(sent, executed)
        refused = sum(command.words[-1] is Word.EXPIRED for command in sent)
        done = sum(len(events) for events in executed.values())
        print(f"{leg}: {len(sent)} commands, {done} executed, {refused} expired, none late")
        assert done > 0
        assert refused > 0


async def _fly_up(drone: Any) -> None:
    for command in (Arm(), Takeoff(5)):
        assert (await drone.send(command)).word is Word.COMPLETED


async def _stall_now_and_then(stallers: list[Staller], ending: asyncio.Event) -> None:
    while not ending.is_set():
        for staller in stallers:
            staller.stall()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(ending.wait(), STALL_S)
        for staller in stallers:
            staller.go_on()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(ending.wait(), FLOW_S)


async def _send_many(system: System, fog: Any) -> list[Sent]:
    """Each command flies to a longitude of its own, by which the autopilot's log tells it apart."""
    home = system.control(1, {"get": "state"})
    sent: list[Sent] = []
    listening = []
    for number in range(COMMANDS_PER_LEG):
        drone = 1 + number % 2
        x = round(home["latitude_deg"] * 1e7) + number
        command = Sent(drone, x, time.time_ns() + round(TTL_S * 1e9))
        sent.append(command)
        goto = Goto(x / 1e7, home["longitude_deg"], 5)
        listening.append(asyncio.create_task(_listen(fog.drone(drone), goto, command)))
        await asyncio.sleep(PACE_S)
    await asyncio.wait_for(asyncio.gather(*listening), 60)
    return sent


async def _listen(drone: Any, goto: Goto, command: Sent) -> None:
    async for outcome in drone.outcomes(goto, ttl_s=TTL_S, limit_s=20):
        command.words.append(outcome.word)


def _assert_in_time(sent: list[Sent], executed: dict[int, list[dict[str, Any]]]) -> None:
    latest = {(command.drone, command.x): command.latest_ns for command in sent}
    times = Counter((drone, event["params"][4]) for drone, events in executed.items() for event in events)
    assert set(times) <= set(latest), "a drone executed what was sent to another"
    twice = [key for key, count in times.items() if count > 1]
    assert not twice, f"executed more than once: {twice}"
    late = [
        (drone, event["params"][4], (event["t_ns"] - latest[drone, event["params"][4]]) / 1e6)
        for drone, events in executed.items()
        for event in events
        if event["t_ns"] > latest[drone, event["params"][4]]
    ]
    assert not late, f"executed late, by milliseconds: {late}"
