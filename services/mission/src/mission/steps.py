"""Steps of a mission: each waits for its effect, has a limit, and fails with a reason."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable

from .events import EventLog
from .fleet import CommandResult, Fleet, MissionError, Point
from .series import KINDS

PROGRESS_S = 1.0
SAMPLES = 30
COLLECT_SPARE_S = 60.0
"""The time for a drone to reach its sensor, and for the last values to arrive."""


class Steps:
    """The steps of one mission on one fleet.

    `samples` is the number of values in each series that it collects, one per second; `was_reached` returns whether a
    drone's sensor, which has the drone's number, has measured anything.
    """

    def __init__(
        self, fleet: Fleet, log: EventLog, samples: int = SAMPLES, was_reached: Callable[[int], bool] = lambda _: True
    ) -> None:
        self._fleet = fleet
        self._log = log
        self._samples = samples
        self._was_reached = was_reached

    async def command(self, name: str, ask: Callable[[], Awaitable[list[CommandResult]]], limit_s: float) -> None:
        """Command all drones. Raises MissionError unless each completes it.

        The step lasts longer than `limit_s` if the protocol may give last words later.
        """
        async with self._step(name, self._fleet.within(limit_s)):
            results = await ask()
            answered = {result.drone for result in results}
            failed = [str(result) for result in results if not result.completed]
            failed += [f"drone {drone}: no answer" for drone in self._fleet.drones if drone not in answered]
            if failed:
                raise MissionError(f"{name}: {'; '.join(failed)}")

    async def goto_best(self, point: Point, limit_s: float) -> int:
        """Send the drone that arrives first, and return its number. Raises MissionError unless it arrives."""
        async with self._step("goto", limit_s):
            result = await self._fleet.goto_best(point)
            if not result.completed:
                raise MissionError(str(result))
        return result.drone

    async def hold(self, seconds: float) -> None:
        """Wait while all drones stay armed. Raises MissionError if one is disarmed."""
        async with self._step("hold", seconds + 5):
            until = asyncio.get_running_loop().time() + seconds
            while (left_s := until - asyncio.get_running_loop().time()) > 0:
                fallen = [drone for drone in self._fleet.drones if self._fleet.status(drone).armed is False]
                if fallen:
                    raise MissionError(f"hold: drone {fallen[0]} is disarmed")
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(left_s):
                        await self._fleet.changed()

    async def until(self, name: str, condition: Callable[[int], bool], limit_s: float) -> None:
        """Wait until every drone fulfils a condition. Raises MissionError with the drones' states at the limit."""
        async with self._step(name, limit_s):
            while not all(condition(drone) for drone in self._fleet.drones):
                await self._fleet.changed()

    async def collect(self) -> None:
        """Wait until every series of every drone's sensor has arrived. Raises MissionError naming the missing ones."""
        async with self._step("collect", self._samples + COLLECT_SPARE_S, self._uncollected):
            while self._uncollected():
                before = len(self._fleet.readings)
                while len(self._fleet.readings) == before:
                    await self._fleet.changed()

    def _uncollected(self) -> str:
        """The values that have not arrived yet; empty when all have."""
        arrived = Counter((reading.drone, reading.kind) for reading in self._fleet.readings)
        said = []
        for drone in self._fleet.drones:
            short = [kind for kind in KINDS if arrived[drone, kind] < self._samples]
            if len(short) == len(KINDS) and not any(arrived[drone, kind] for kind in KINDS):
                why = "sent nothing that arrived" if self._was_reached(drone) else "was never in range"
                said.append(f"drone {drone}: its sensor {drone} {why}")
            elif short:
                values = ", ".join(f"{arrived[drone, kind]} {kind}" for kind in short)
                said.append(f"drone {drone}: {values} of {self._samples} each")
        return "; ".join(said)

    def _places(self) -> str:
        return "; ".join(f"drone {drone}: {self._fleet.status(drone)}" for drone in self._fleet.drones)

    @contextlib.asynccontextmanager
    async def _step(self, name: str, limit_s: float, describe: Callable[[], str] | None = None) -> AsyncIterator[None]:
        """A step with its limit; `describe` gives the situation if the step is not done by then."""
        self._log.write("step", name=name, limit_s=limit_s)
        showing = asyncio.create_task(self._show(name))
        try:
            async with asyncio.timeout(limit_s):
                yield
        except TimeoutError:
            reason = f"{name}: not done within {limit_s:g} s ({(describe or self._places)()})"
            self._log.write("step_done", name=name, ok=False, reason=reason)
            raise MissionError(reason) from None
        except MissionError as error:
            reason = str(error) if str(error).startswith(f"{name}: ") else f"{name}: {error}"
            self._log.write("step_done", name=name, ok=False, reason=reason)
            raise MissionError(reason) from error
        finally:
            showing.cancel()
            self._show_once(name)
        self._log.write("step_done", name=name, ok=True, reason=None)

    async def _show(self, name: str) -> None:
        while True:
            self._show_once(name)
            await asyncio.sleep(PROGRESS_S)

    def _show_once(self, name: str) -> None:
        self._log.show(name, {drone: str(self._fleet.status(drone)) for drone in self._fleet.drones})
