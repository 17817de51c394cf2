"""A real PX4 in flight: how a `hold` stops it in a goto, and whether it climbs when armed after a denied takeoff.

`PX4_DIR=FOLDER python -m tests.bench holds` takes half an hour, in the autopilot's own time.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mqttxt import Arm, Disarm, Drone, Goto, Land, Outcome, Takeoff, Word
from tests.rigs.commanding import fly, start
from tests.rigs.processes import eventually
from tests.rigs.px4 import HOLD, Px4, Px4Pilot
from tests.rigs.real_flights import HOME, Flight, Pilot

GOALS = {5.0: (5.0, 45.0), 10.0: (7.0, 45.0)}
"""By a goto's speed in metres per second: the seconds and metres within which the drone is to stand still."""
COUNT = 20
AT_ONCE = 5
"""Holds per flight: a battery lasts for that many."""
AWAY_DEG = 0.004
STILL_M_S = 0.5
LIMIT_S = 15.0
WATCHED_S = 5.0
"""A PX4 in takeoff mode has left the ground by then."""


@dataclass(frozen=True, slots=True)
class Stop:
    after_s: float
    """Time until it is still after a hold in a goto; LIMIT_S if it is not."""
    way_m: float
    """The distance north or east, whichever is greater."""
    word: str
    """The hold's last word."""


def measure() -> Iterator[str]:
    for speed_m_s in GOALS:
        yield from asyncio.run(_measure(speed_m_s))


async def _measure(speed_m_s: float) -> list[str]:
    folder = Path(tempfile.mkdtemp(prefix="holds-"))
    autopilot = Px4(folder)
    with Flight(folder, autopilot, Px4Pilot(autopilot.pilots_port)) as flight:
        flight.pilot.set_parameter("MPC_XY_CRUISE", speed_m_s)
        flight.pilot.set_parameter("MPC_XY_VEL_MAX", max(12.0, speed_m_s))
        flight.pilot.set_parameter("SIM_BAT_DRAIN", 86_400.0)
        stops: list[Stop] = []
        while len(stops) < COUNT:
            async with flight.drone() as drone:
                await fly(drone, Arm(), Takeoff(15.0))
                stops += [await _stop(drone, flight.pilot, speed_m_s) for _ in range(AT_ONCE)]
                await fly(drone, Land())
        stayed = 0
        for _ in range(COUNT):
            async with flight.drone() as drone:
                stayed += await _stays(drone, flight.pilot)
    goal_s, goal_m = GOALS[speed_m_s]
    longest, farthest = max(stop.after_s for stop in stops), max(stop.way_m for stop in stops)
    words = ", ".join(f"{count} {word}" for word, count in Counter(stop.word for stop in stops).items())
    return [
        f"hold at {speed_m_s:g} m/s: {sum(stop.after_s <= goal_s and stop.way_m <= goal_m for stop in stops)}"
        f" of {len(stops)} still within {goal_s:g} s and {goal_m:g} m ({words});"
        f" after {longest:.2f} s and {farthest:.1f} m at most",
        f"takeoff while disarmed, then arm: {stayed} of {COUNT} denied, and on the ground",
    ]


async def _stop(drone: Drone, pilot: Pilot, speed_m_s: float) -> Stop:
    north = AWAY_DEG if pilot.position_m[0] <= 0 else -AWAY_DEG
    _, going = await start(drone, Goto(HOME[0] + north, HOME[1], 15.0))
    await eventually(lambda: pilot.speed_m_s > 0.9 * speed_m_s, "it flies", 60)
    began, there = time.monotonic(), pilot.position_m
    holding: asyncio.Task[Outcome] = asyncio.ensure_future(drone.hold())
    after = LIMIT_S
    while after == LIMIT_S and time.monotonic() - began < LIMIT_S:
        await asyncio.sleep(0.02)
        if pilot.mode == HOLD and pilot.speed_m_s < STILL_M_S:
            after = time.monotonic() - began
    said = await holding
    await going
    way_m = max(abs(now - then) for now, then in zip(pilot.position_m[:2], there[:2], strict=True))
    return Stop(after, way_m, said.word.label)


async def _stays(drone: Drone, pilot: Pilot) -> bool:
    said = await drone.send(Takeoff(10.0))
    await fly(drone, Arm())
    until = time.monotonic() + WATCHED_S
    stayed = pilot.landed
    while time.monotonic() < until:
        await asyncio.sleep(0.02)
        stayed = stayed and pilot.landed
    await fly(drone, Disarm())
    return stayed and (said.word, said.reason) == (Word.DENIED, "disarmed")
