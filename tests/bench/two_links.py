"""A drone with two connections: the cost of measuring them, and the gap after a cut, compared with one connection.

The quicker link takes 50 ms each way, the slower one, which stands in for a satellite, 300 ms. Bytes are whole frames,
as `bytes_fleet` counts them, by Linux's counts of each connection.
"""

from __future__ import annotations

import asyncio
import statistics
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from mqttxt import Arm, Disarm, Drone, GroundStation, Hold, StateUpdate, Stream
from mqttxt.protocol.commands import Command
from tests.rigs.processes import eventually
from tests.rigs.two_links import TwoLinkSystem

ONE_WAY_S = (0.05, 0.3)
TURNS = 8
DOWN_S = 3.0
"""How long the quicker link is cut, or held up."""
BEHIND_S = 0.1
"""The time from the cut to a command."""
RATE_HZ = 20.0
SETTLE_S, WINDOW_S = 3.0, 20.0
"""The window holds two intervals of beacons and leases."""
HOW = ("cut", "held up")


@dataclass
class Times:
    """Times of all turns, in seconds: gaps without a state, and from a command to its last word."""

    gaps: list[float] = field(default_factory=list)
    arm: list[float] = field(default_factory=list)
    hold: list[float] = field(default_factory=list)


class Arrivals:
    """When states arrived, by time.monotonic()."""

    def __init__(self, station: GroundStation) -> None:
        self.times: list[float] = []
        self._task = asyncio.create_task(self._listen(station))

    async def _listen(self, station: GroundStation) -> None:
        async for said in station.events():
            if isinstance(said, StateUpdate):
                self.times.append(time.monotonic())

    def longest_gap(self, start_s: float, end_s: float) -> float:
        """The longest time without a state within this span, its ends included."""
        inside = [start_s, *(at for at in self.times if start_s < at < end_s), end_s]
        return max(later - earlier for earlier, later in pairwise(inside))


def measure() -> list[str]:
    """Lines of figures; takes about five minutes."""
    return asyncio.run(_measure())


async def _measure() -> list[str]:
    async with _flying(two=True) as (system, drone, arrivals):
        lines = [await _probing(system, one_way_s) for one_way_s in ONE_WAY_S]
        both = {how: await _broken(system, drone, arrivals, how) for how in HOW}
    async with _flying(two=False) as (system, drone, arrivals):
        alone = {how: await _broken(system, drone, arrivals, how) for how in HOW}
    for how in HOW:
        for what, of_two, of_one in (
            (f"longest gap of states at {RATE_HZ:g} Hz", both[how].gaps, alone[how].gaps),
            ("arm or disarm to its last word", both[how].arm, alone[how].arm),
            ("hold to its last word", both[how].hold, alone[how].hold),
        ):
            lines.append(_line(f"link {how} for {DOWN_S:g} s: {what}", of_two, of_one))
    return lines


def _line(what: str, of_two: list[float], of_one: list[float]) -> str:
    median_s, one_s, trip_s = statistics.median(of_two), statistics.median(of_one), 2 * ONE_WAY_S[1]
    return (
        f"{what}: median {median_s:.2f} s, {median_s / trip_s:.1f} round trips of the slower link, at most"
        f" {max(of_two):.2f} s; with one connection {one_s:.2f} s: {median_s / one_s:.2f} times"
    )


@asynccontextmanager
async def _flying(two: bool) -> AsyncIterator[tuple[TwoLinkSystem, Drone, Arrivals]]:
    with tempfile.TemporaryDirectory() as name:
        system = TwoLinkSystem(Path(name), two_links=two)
        for link, one_way_s in zip(system.links, ONE_WAY_S, strict=True):
            link.one_way_s = one_way_s
        async with system.flying() as (station, drone):
            yield system, drone, Arrivals(station)


async def _probing(system: TwoLinkSystem, one_way_s: float) -> str:
    """Measure the connection that is not in use: PINGREQs and answers, leases, and words, of which there are none."""
    await eventually(lambda: system.in_use() == 1, "the quicker link is in use")
    link = system.links[1]
    link.one_way_s = one_way_s
    await asyncio.sleep(SETTLE_S)
    frames, size = link.frames()
    await asyncio.sleep(WINDOW_S)
    frames, size = (after - before for after, before in zip(link.frames(), (frames, size), strict=True))
    trip_ms = 2000 * one_way_s
    return (
        f"an idle second connection, answers after {trip_ms:.0f} ms: {size / WINDOW_S:.0f} bytes per second in"
        f" {frames / WINDOW_S:.1f} frames"
    )


async def _broken(system: TwoLinkSystem, drone: Drone, arrivals: Arrivals, how: str) -> Times:
    """Break the quicker link in each turn, while states arrive and one command is sent."""
    assert (await drone.send(Stream("location", RATE_HZ))).completed
    times, link = Times(), system.links[0]
    commands: list[Command] = [Arm(), Hold(), Disarm(), Hold()]
    for turn in range(TURNS):
        await _flows(system, arrivals)
        command, cut_s = commands[turn % len(commands)], time.monotonic()
        if how == "cut":
            link.cut()
        else:
            link.stall()
        await asyncio.sleep(BEHIND_S)
        sending = asyncio.create_task(_taken_s(drone, command))
        await asyncio.sleep(DOWN_S - BEHIND_S)
        link.go_on()
        (times.hold if isinstance(command, Hold) else times.arm).append(await sending)
        await _flows(system, arrivals)
        times.gaps.append(arrivals.longest_gap(cut_s - 1, time.monotonic()))
    return times


async def _taken_s(drone: Drone, command: Command) -> float:
    """The time from a command to its completion; it is sent again if the drone was unreachable."""
    start_s = time.monotonic()
    while not (await drone.send(command, ttl_s=20)).completed:
        await asyncio.sleep(0.05)
    return time.monotonic() - start_s


async def _flows(system: TwoLinkSystem, arrivals: Arrivals) -> None:
    """Wait until the quicker link is in use (again), and states arrive over it."""
    await eventually(lambda: system.in_use() == 1, "the quicker link is in use")
    since_s = time.monotonic()
    await eventually(lambda: sum(at > since_s for at in arrivals.times) > RATE_HZ, "states come")
