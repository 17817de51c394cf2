"""Commands to a drone in tests of whole flights, for any autopilot."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable

from mqttxt import Command, Drone, GroundStation, Health, Outcome, Word
from tests.rigs.processes import eventually

BOOT_S = 180.0
"""PX4 arms 30 to 45 s after its start, ArduCopter has a position after 42 s; later on a busy machine."""


def is_armable(drone: Drone) -> bool:
    health = drone.state(Health)
    return drone.is_controlled and health is not None and health.state.armable


async def controlled(station: GroundStation) -> Drone:
    """Drone 1 of fog 1, once it is reachable and under the station's control."""
    (fog,) = await station.connect([1])
    drone = fog.drone(1)
    await eventually(lambda: drone.is_reachable and drone.is_controlled, "drone 1 is reachable and controlled")
    return drone


async def armable(drone: Drone) -> None:
    await eventually(lambda: is_armable(drone), "the drone is reachable and would arm", BOOT_S)


async def fly(drone: Drone, *commands: Command) -> None:
    """Send one command after the other, each of which has to complete."""
    for command in commands:
        last = await drone.send(command)
        assert (last.word, last.reason) == (Word.COMPLETED, None), f"{command}: {last.word}({last.reason})"


def follow(sent: AsyncIterable[Outcome]) -> tuple[list[Outcome], asyncio.Task[None]]:
    """The outcomes of a command, as they arrive, and the task that collects them."""
    heard: list[Outcome] = []

    async def listen() -> None:
        async for outcome in sent:
            heard.append(outcome)

    return heard, asyncio.create_task(listen())


async def start(drone: Drone, command: Command) -> tuple[list[Outcome], asyncio.Task[None]]:
    """Send a command and return once it was accepted."""
    heard, task = follow(drone.send(command))
    await eventually(lambda: bool(heard), f"{command.name} is answered")
    assert heard[0].word is Word.ACCEPTED, heard
    return heard, task
