"""The message set: ten kinds of messages to and from one drone, COUNT of each, one kind after the other.

For commands the unit is one API call, up to the autopilot's acknowledgement; before each call the drone is put into the
kind's starting state. For states the unit is one value, at 1 Hz. Failures are counted, and the next unit follows.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from dataclasses import dataclass, field

from .events import EventLog
from .fleet import MessageFleet, MissionError, StateValue
from .side_channel import SideChannel

HOVER_M = 10.0
FOLLOW_LIMIT_S = 30.0
"""How long to wait until the ground station knows of a starting state; afterwards the call is made in any case."""
TURN_S, SPARE_S = 1.0, 3.0
"""The time between two values, and the delay after which a value counts as missing."""


@dataclass(frozen=True)
class Start:
    """A starting state: at home, on the ground or hovering (then armed)."""

    armed: bool
    altitude_m: float


COMMANDS = {
    "arm": Start(armed=False, altitude_m=0.0),
    "takeoff": Start(armed=True, altitude_m=0.0),
    "land": Start(armed=True, altitude_m=HOVER_M),
    "offboard": Start(armed=True, altitude_m=HOVER_M),
    "goto": Start(armed=True, altitude_m=HOVER_M),
}
"""The commands in their order, with the drone's starting state for each."""
STATES = ("battery", "location", "groundspeed", "flight_mode", "heading")
ON_GROUND, HOVERING = COMMANDS["arm"], COMMANDS["land"]


@dataclass
class KindTally:
    """How many units of a kind succeeded, and why the others failed."""

    received: int = 0
    reasons: Counter[str] = field(default_factory=Counter)

    @property
    def missing(self) -> int:
        return self.reasons.total()

    def __str__(self) -> str:
        return ", ".join(f"{count} {reason}" for reason, count in self.reasons.items())


class MessageSet:
    """Flies the message set with one drone."""

    def __init__(self, fleet: MessageFleet, log: EventLog, channel: SideChannel, count: int) -> None:
        self._fleet = fleet
        self._log = log
        self._channel = channel
        self._count = count

    async def fly(self) -> None:
        """Fly all kinds. Raises MissionError at the end, naming every kind without a success."""
        tallies = {name: await self._calls(name) for name in COMMANDS}
        await self._reset(HOVERING)
        await self._fleet.stop_fixed_rates()
        tallies |= {name: await self._values(name) for name in STATES}
        await self._reset(ON_GROUND)
        silent = [f"{name}: none of {self._count} ({tally})" for name, tally in tallies.items() if not tally.received]
        if silent:
            raise MissionError("; ".join(silent))

    async def _calls(self, name: str) -> KindTally:
        """Make COUNT calls of a command."""
        self._began(name, "command")
        tally = KindTally()
        for number in range(1, self._count + 1):
            self._show(name, number)
            call = self._log.next_call()
            followed = await self._reset(COMMANDS[name])
            self._log.write("reset", call=call, followed=followed)
            result = await self._fleet.call(call, name)
            if result.word in ("accepted", "completed"):
                tally.received += 1
                await self._shown(name)
            else:
                tally.reasons[result.word + (f" ({result.reason})" if result.reason else "")] += 1
        self._done(name, tally)
        return tally

    async def _values(self, name: str) -> KindTally:
        """Receive COUNT values of a state, which is published at 1 Hz meanwhile."""
        tally = KindTally()
        try:
            values = await self._fleet.request_state(name)
        except MissionError as error:
            self._began(name, "state")
            tally.reasons[str(error)] = self._count
            self._done(name, tally)
            return tally
        await self._align(values)
        self._began(name, "state")
        clock = asyncio.get_running_loop().time
        taken_s = clock()
        for number in range(1, self._count + 1):
            self._show(name, number)
            try:
                value, age_ms = await self._next(values, taken_s)
            except TimeoutError:
                tally.reasons["did not come in time"] += 1
            else:
                tally.received += 1
                self._log.write("value", name=name, number=number, value=value, age_ms=age_ms)
            taken_s = clock()
        self._done(name, tally)
        await self._fleet.stop_state(name)
        return tally

    async def _align(self, values: asyncio.Queue[StateValue]) -> None:
        """Wait for a value, if one arrives: a kind begins right after it, so that it has COUNT whole turns."""
        while not values.empty():
            values.get_nowait()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(TURN_S + SPARE_S):
                await values.get()

    async def _next(self, values: asyncio.Queue[StateValue], taken_s: float) -> StateValue:
        """The next value to arrive; of a state at a higher rate, the newest once per second."""
        async with asyncio.timeout_at(taken_s + TURN_S + SPARE_S):
            if self._fleet.tells_faster:
                await asyncio.sleep(taken_s + TURN_S - asyncio.get_running_loop().time())
            told = await values.get()
            while self._fleet.tells_faster and not values.empty():
                told = values.get_nowait()
            return told

    async def _reset(self, start: Start) -> bool:
        """Put the drone into a starting state; returns whether the ground station knows of it.

        It is first disarmed, which ends the last call, with its last word. It is then disarmed again, because a late
        copy of that call may have armed it.
        """
        await self._channel.set(armed=False)
        settled = await self._fleet.settle()
        await self._channel.set(armed=False)
        followed = await self._follow(armed=False)
        if start.armed:
            await self._channel.set(armed=True, altitude_m=start.altitude_m)
            followed = await self._follow(armed=True) and followed
        return followed and settled

    async def _shown(self, name: str) -> None:
        """Wait until a drone shows that it is armed, by its next heartbeat: a reset before that would hide it."""
        if name == "arm":
            await self._follow(armed=True)

    async def _follow(self, armed: bool) -> bool:
        try:
            async with asyncio.timeout(FOLLOW_LIMIT_S):
                while not self._fleet.follows(armed):
                    await self._fleet.changed()
        except TimeoutError:
            return False
        return True

    def _began(self, name: str, form: str) -> None:
        self._log.write("kind", name=name, form=form, count=self._count)

    def _done(self, name: str, tally: KindTally) -> None:
        self._log.write("kind_done", name=name, received=tally.received, missing=tally.missing)

    def _show(self, name: str, number: int) -> None:
        self._log.show(name, dict.fromkeys(self._fleet.drones, f"{number} of {self._count}"))
