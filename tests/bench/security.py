"""The cost of SECURITY: the same fleet without it, in TLS, and in TLS with signed messages, in turns in one run.

Bytes of a command and of its words on the way to the drone, the time from a call to the autopilot, and the processor
time of an activator under the load of `activator`.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from mqttxt import Drone
from tests.bench.activator import DRONES_A_FOG, FULL_HZ, Relayed, relay_by_activators, relay_secured
from tests.bench.always_armed import AlwaysArmed
from tests.bench.armed_drone import ArmedDrone
from tests.bench.capture import Capture, Frame
from tests.bench.latency import MEMORY, Percentiles

SECURITY = ("none", "tls", "signed")
TURNS, WARM_UP = 500, 20
APART_S = 0.1
"""Between two measured calls' frames: longer than TCP may delay an acknowledgement."""
SIZED = 20
"""Calls whose frames are examined."""
LEAST_CARRIED = 40
"""Bytes of TCP: more than a PUBACK in TLS has, less than a command or a word."""
ROUNDS = 3


@dataclass
class Fleet:
    """One of the three fleets; traffic between the drone and its fog's broker has that broker's port."""

    autopilot: AlwaysArmed
    drone: Drone
    fog_port: int
    times_ms: list[float] = field(default_factory=list)
    marks: list[tuple[float, float]] = field(default_factory=list)

    async def arm(self) -> float:
        """Call arm and await its last word; returns the milliseconds to the autopilot's first receipt."""
        before, called_ns = len(self.autopilot.heard_ns), time.time_ns()
        outcome = await self.drone.arm()
        assert outcome.completed, outcome
        return (self.autopilot.heard_ns[before] - called_ns) / 1e6


def measure() -> list[str]:
    """Lines of figures; takes about three minutes."""
    return [*asyncio.run(_calls()), *asyncio.run(_load())]


async def _calls() -> list[str]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        async with AsyncExitStack() as stack:
            fleets = {how: await stack.enter_async_context(_fleet(folder / how, how)) for how in SECURITY}
            for turn in range(WARM_UP + TURNS):
                for fleet in fleets.values():
                    took_ms = await fleet.arm()
                    if turn >= WARM_UP:
                        fleet.times_ms.append(took_ms)
            with Capture(folder, [fleet.fog_port for fleet in fleets.values()]) as capture:
                for _ in range(SIZED):
                    for fleet in fleets.values():
                        start = time.time()
                        await fleet.arm()
                        await asyncio.sleep(APART_S)
                        fleet.marks.append((start, time.time()))
    return [*_size_lines(fleets, capture), *_time_lines(fleets)]


@asynccontextmanager
async def _fleet(folder: Path, how: str) -> AsyncIterator[Fleet]:
    folder.mkdir()
    with tempfile.TemporaryDirectory(dir=MEMORY) as journals:
        system = ArmedDrone(folder, Path(journals), "" if how == "none" else how)
        async with system.flying() as (_, drone):
            yield Fleet(system.autopilot, drone, system.fog.port)


def _size_lines(fleets: dict[str, Fleet], capture: Capture) -> list[str]:
    """The command is the first frame that the fog's broker sends in a call; its words return, often in one frame."""
    found = {}
    for how, fleet in fleets.items():
        calls = [capture.between(*mark) for mark in fleet.marks]
        down = [
            next(frame for frame in frames if _carries(frame) and frame.source == fleet.fog_port) for frames in calls
        ]
        (drone,) = {frame.target for frame in down}
        up = [sum(frame.size for frame in frames if _carries(frame) and frame.source == drone) for frames in calls]
        found[how] = (median(frame.size for frame in down), median(up))
    return [
        f"security: bytes between the fog's broker and the drone, {what}: "
        + ", ".join(f"{how} {found[how][place]:.0f}" for how in SECURITY)
        + f"; signed {found['signed'][place] - found['tls'][place]:+.0f} to tls"
        for place, what in enumerate(("arm", "its two words"))
    ]


def _carries(frame: Frame) -> bool:
    """Whether a frame carries more than an acknowledgement."""
    return frame.carried >= LEAST_CARRIED


def _time_lines(fleets: dict[str, Fleet]) -> list[str]:
    took = {how: Percentiles.of(fleet.times_ms) for how, fleet in fleets.items()}
    said = "; ".join(f"{how} {one}" for how, one in took.items())
    ratios = ", ".join(f"{how} {took[how].p50 / took['none'].p50:.2f}" for how in SECURITY[1:])
    return [
        f"security: {TURNS} calls, from a call of the API to the autopilot's receipt, on loopback: {said}; "
        f"p50 over none's: {ratios}; signed over tls {took['signed'].p50 / took['tls'].p50:.2f}"
    ]


async def _load() -> list[str]:
    found: dict[str, list[Relayed]] = {how: [] for how in SECURITY}
    for _ in range(ROUNDS):
        found["none"].append(await relay_by_activators(1, DRONES_A_FOG, FULL_HZ))
        for how in SECURITY[1:]:
            found[how].append(await relay_secured(DRONES_A_FOG, FULL_HZ, how))
    used_s = {how: median(one.cpu_s for one in turns) for how, turns in found.items()}
    lost = {how: sum(one.lost for one in turns) for how, turns in found.items()}
    said = ", ".join(f"{how} {100 * used_s[how] / found[how][0].wall_s:.0f} % of a core" for how in SECURITY)
    ratios = ", ".join(f"{how} {used_s[how] / used_s['none']:.2f}" for how in SECURITY[1:])
    return [
        f"security: an activator that relays {found['none'][0].states / found['none'][0].wall_s:,.0f} states a second, "
        f"median of {ROUNDS} turns: {said}; over none's: {ratios}; signed over tls "
        f"{used_s['signed'] / used_s['tls']:.2f}; lost {lost}"
    ]
