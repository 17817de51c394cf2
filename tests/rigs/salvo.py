"""A salvo of commands with short deadlines, judged by the autopilots' own logs."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

from mqttxt import FogUnreachable, GroundStation, Outcome, SentCommand, Word
from mqttxt.core.clock import SessionClock, system_clock_ns
from tests.rigs.processes import System, eventually

MAV_CMD_DO_REPOSITION = 192
TTL_S = 0.6
LIMIT_S = 3.0
PACE_S = 0.03
FAST, SLOW = 1000, -1000
"""Clock rates in millionths, at both ends of the allowed range."""


@dataclass
class Sent:
    """A command that was sent: the latest time at which it may be executed, and its outcome.

    `late_ms`: the drone's own word that its clock read past the deadline after the write.
    """

    drone: int
    x: int
    latest_ns: int = 0
    late_ms: int | None = None
    words: list[Word] = field(default_factory=list)
    last_words: int = 0
    refused_in_time: bool = False


@dataclass
class Salvo:
    """The commands of one test; the autopilots' logs tell them apart by their `x`, a latitude."""

    system: System
    next_x: int
    y: float
    sent: list[Sent] = field(default_factory=list)
    unsent: int = 0

    def anew(self) -> Salvo:
        """A salvo of its own; it goes on where this one's longitudes ended."""
        return replace(self, sent=[], unsent=0)

    async def fire(self, fog: Any, count: int) -> None:
        """Send commands at a steady pace and wait for their last words."""
        listening = []
        for number in range(count):
            self.next_x += 1
            command = Sent(1 + number % 2, self.next_x)
            try:
                said = fog.drone(command.drone).goto(command.x / 1e7, self.y, 5, ttl_s=TTL_S, limit_s=LIMIT_S)
            except FogUnreachable:
                self.unsent += 1
            else:  # it is sent: its deadline is no later than this
                command.latest_ns = time.time_ns() + round(TTL_S * 1e9)
                listening.append(asyncio.create_task(self._listen(said, command)))
            await asyncio.sleep(PACE_S)
        async with asyncio.timeout(60):
            await asyncio.gather(*listening)

    async def _listen(self, said: SentCommand[Outcome, Outcome], command: Sent) -> None:
        self.sent.append(command)
        async for outcome in said:
            command.words.append(outcome.word)
            command.last_words += outcome.is_last  # the truth that settles an `unconfirmed` is no last word
            command.late_ms = command.late_ms or outcome.late_ms
            if outcome.word is Word.EXPIRED and time.time_ns() < command.latest_ns:
                command.refused_in_time = True

    def verdict(self, what: str) -> Counter[str]:
        """Assert that none ran late, twice or elsewhere, and each has exactly one last word; returns the counts."""
        wrong = [command for command in self.sent if command.last_words != 1]
        assert not wrong, f"not one last word: {wrong}"
        latest = {(command.drone, command.x): command.latest_ns for command in self.sent}
        executed = [
            (drone, event["params"][4], event["arrived_ns"])
            for drone in self.system.autopilots
            for event in self.system.commanded(drone, MAV_CMD_DO_REPOSITION)
        ]
        mine = [(drone, x, t_ns) for drone, x, t_ns in executed if (drone, x) in latest]
        others = {x for _, x, _ in executed} & {command.x for command in self.sent} - {x for _, x, _ in mine}
        assert not others, f"a drone executed what was sent to another: {others}"
        twice = [key for key, count in Counter((drone, x) for drone, x, _ in mine).items() if count > 1]
        assert not twice, f"executed more than once: {twice}"
        said = {(command.drone, command.x) for command in self.sent if command.late_ms}
        late = [
            (drone, x, (t - latest[drone, x]) / 1e6)
            for drone, x, t in mine
            if t > latest[drone, x] and (drone, x) not in said
        ]
        assert not late, f"executed late, by milliseconds: {late}"
        counts = Counter(command.words[-1].label for command in self.sent)
        counts |= Counter(
            sent=len(self.sent),
            unsent=self.unsent,
            executed=len(mine),
            refused_in_time=sum(command.refused_in_time for command in self.sent),
            paused_in_the_write=len(said),
        )
        print(f"{what}: none late, none twice of {dict(counts)}")
        return counts


def station(url: str) -> GroundStation:
    """A ground station whose clock is fast by FAST."""
    start_ns = system_clock_ns()
    clock = SessionClock(lambda: start_ns + (system_clock_ns() - start_ns) * (1_000_000 + FAST) // 1_000_000)
    return GroundStation(url, clock=clock)


async def all_reachable(fog: Any) -> None:
    await eventually(lambda: fog.is_live and all(fog.drone(d).is_reachable for d in (1, 2)), "both drones reachable")


async def aloft(system: System, fog: Any) -> Salvo:
    """Fly both drones up; the salvo's commands send them to places a centimetre apart."""
    await all_reachable(fog)
    await asyncio.gather(*(_fly_up(fog.drone(drone)) for drone in (1, 2)))
    home = system.control(1, {"get": "state"})
    return Salvo(system, round(home["latitude_deg"] * 1e7), home["longitude_deg"])


async def _fly_up(drone: Any) -> None:
    assert (await drone.arm()).completed
    assert (await drone.takeoff(5)).completed
