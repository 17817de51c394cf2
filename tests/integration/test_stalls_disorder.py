"""Deadlines hold whatever the order: messages overtake each other and come again, late, on both sides of the fog."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Any

import pytest
import pytest_asyncio

from tests.rigs.disorder import Disorder
from tests.rigs.processes import Broker, System
from tests.rigs.salvo import FAST, SLOW, Salvo, all_reachable, aloft, station

pytestmark = [pytest.mark.integration, pytest.mark.asyncio(loop_scope="module")]
ONE_HOP = pytest.mark.soak(
    *(f"services/mqttxt/src/mqttxt/{node}" for node in ("core", "station", "activator", "drone"))
)

COMMANDS = 200
DELAY_S = 0.8
"""More than the commands' time to live."""


@dataclass
class Fleet:
    """A system with a second broker on each side, and disorder between the two."""

    fog: Any
    salvo: Salvo
    disorder: dict[str, Disorder]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def fleet(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Fleet]:
    folder = tmp_path_factory.mktemp("disorder")
    system = System(folder)
    near, far = Broker(folder, "near"), Broker(folder, "far")
    with contextlib.ExitStack() as ends:
        for broker in (near, far):
            ends.callback(broker.kill)
            broker.start()
        ends.callback(system.close)
        system.activator = system.make_activator(system.cloud.url, system.fog.url, ppm=SLOW)
        for drone, ppm in ((1, SLOW), (2, FAST)):
            system.uavs[drone] = system.make_uav(drone, far.url, ppm=ppm)
        await asyncio.to_thread(system.start)
        disorder = {
            "station - fog": Disorder(near.port, system.cloud.port),
            "fog - drones": Disorder(system.fog.port, far.port),
        }
        for one in disorder.values():
            one.start()
            ends.callback(one.close)
        async with station(near.url) as gs:
            (fog,) = await gs.connect([1])
            yield Fleet(fog, await aloft(system, fog), disorder)


@pytest.mark.parametrize(
    "hops",
    [
        *(pytest.param((hop,), marks=ONE_HOP) for hop in ("station - fog", "fog - drones")),
        ("station - fog", "fog - drones"),
    ],
)
async def test_no_command_is_executed_late_or_twice_in_disorder(fleet: Fleet, hops: tuple[str, ...]) -> None:
    await all_reachable(fleet.fog)
    salvo = fleet.salvo = fleet.salvo.anew()
    before = sum(one.repeated for one in fleet.disorder.values())
    for hop in hops:
        fleet.disorder[hop].delay_s = DELAY_S
    try:
        await salvo.fire(fleet.fog, COMMANDS)
    finally:
        for hop in hops:
            fleet.disorder[hop].delay_s = 0.0
    counts = salvo.verdict(f"disorder, {' and '.join(hops)}")
    assert sum(one.repeated for one in fleet.disorder.values()) > before
    assert counts["executed"] > 0
    assert counts["expired"] > 0
