"""One drone through MAVSDK: its telemetry as states, its set-up before the mission, and its loss."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncGenerator, Callable, Coroutine
from dataclasses import asdict
from typing import Any, TypeVar

from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.asyncio.system import System
from mavsdk.plugins.action import ActionError, ActionResult
from mavsdk.plugins.telemetry import FlightMode, LandedState, Position, TelemetryError, TelemetryResult

from mqttxt import Word

from .events import EventLog
from .fleet import MissionError
from .mavsdk_outcomes import Goal, HeartbeatCount, TimedValue, View, landed_of, mode_of, place_of

logger = logging.getLogger("mavsdk")
Value = TypeVar("Value")
Answer = TypeVar("Answer")

LOST_S = 10.0
"""A drone is lost when it stays silent this long after MAVSDK missed its heartbeats for three seconds."""
LOCATION_LOG_S = 0.75
"""The least time between logged locations: fifty per second are too many, and of one per second all are logged."""
FIVE_STATES_HZ = 1.0
_AGAIN = (
    TelemetryResult.TIMEOUT,
    TelemetryResult.BUSY,
    ActionResult.TIMEOUT,
    ActionResult.BUSY,
    ActionResult.PARAMETER_ERROR,  # MAVSDK's Action also gives this for a parameter that did not arrive in time
)


class Calls:
    """MAVSDK's calls, which run in threads: a cancelled call goes on in its thread until MAVSDK gives it up."""

    def __init__(self) -> None:
        self._open: set[asyncio.Task[Any]] = set()

    async def run(self, call: Coroutine[Any, Any, Answer]) -> Answer:
        """Run a call and return its answer."""
        task = asyncio.ensure_future(call)
        self._open.add(task)
        task.add_done_callback(self._ended)
        return await asyncio.shield(task)

    async def wait(self) -> None:
        """Wait until no call is open; MAVSDK ends each within three seconds."""
        if self._open:
            await asyncio.wait(self._open)

    def _ended(self, task: asyncio.Task[Any]) -> None:
        self._open.discard(task)
        if not task.cancelled():
            task.exception()  # which a cancelled caller does not retrieve


class MavsdkDrone:
    """A vehicle by its MAVLink system id, which is the drone's number. `on_news` is called after each message."""

    def __init__(
        self,
        number: int,
        fog: int,
        system: System,
        streams: str,
        log: EventLog,
        calls: Calls,
        on_news: Callable[[], None],
    ) -> None:
        self.number = number
        self.fog = fog
        self.action = ActionAsync(system)
        self.view = View(tells_landed=streams != "five-states")
        self.heartbeats = HeartbeatCount()
        self.takeoff_altitude_m: float | None = None
        self.is_set_up = False
        self.unanswered: str | None = None
        self.is_connected = True
        self.is_lost = False
        self._calls = calls
        self.system = system
        self.mission = MissionRawAsync(system)
        self.telemetry = TelemetryAsync(system)
        self._streams = streams
        self._log = log
        self._on_news = on_news
        self._news = asyncio.Event()
        self._clock = asyncio.get_running_loop().time
        self._losing: asyncio.TimerHandle | None = None
        self._logged_place_s = 0.0
        self._tasks = [asyncio.create_task(listening) for listening in self._listeners()]

    async def set_up(self) -> None:
        """Request the streams and read the takeoff altitude. Raises MissionError if a request is refused.

        An unanswered request is repeated until cancelled; `unanswered` has the last one and its result.
        """
        if self._streams == "five-states":
            for state in ("battery", "location", "groundspeed"):
                await self.ask_rate(state, FIVE_STATES_HZ)
        await self._put_back()
        self.takeoff_altitude_m = await self._ask("takeoff altitude", lambda: self.action.get_takeoff_altitude())
        self.is_set_up = True
        self._tell()

    async def ask_rate(self, state: str, rate_hz: float) -> None:
        """Request a state at a rate, Hz; 0 is the vehicle's own. Errors as in `set_up`.

        A flight mode arrives with every heartbeat, whose rate is fixed, and a heading with the location.
        """
        ask: dict[str, tuple[str, Callable[[float], Coroutine[Any, Any, None]]]] = {
            "battery": ("BATTERY_STATUS", self.telemetry.set_rate_battery),
            "location": ("GLOBAL_POSITION_INT", self.telemetry.set_rate_position),
            "heading": ("GLOBAL_POSITION_INT", self.telemetry.set_rate_position),
            "groundspeed": ("VFR_HUD", self.telemetry.set_rate_fixedwing_metrics),
        }
        if state in ask:
            message, set_rate = ask[state]
            await self._ask(message, lambda: set_rate(rate_hz))

    async def settle(self, goal: Goal, asked_s: float) -> tuple[Word, str | None]:
        """Wait for the effect of a command that was just accepted; returns its last word, and a failure's reason."""
        accepted_s = self._clock()
        entered = False
        try:
            async with asyncio.timeout(goal.limit_s):
                while not goal.reached(self.view, asked_s):
                    entered = entered or (self.view.mode is not None and self.view.mode.value in goal.modes)
                    reason = goal.failure(self.view, accepted_s, entered)
                    if reason is not None:
                        return Word.FAILED, reason
                    if self.is_lost:
                        return Word.UNCONFIRMED, "heartbeat_lost"
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            return (Word.FAILED, "timeout") if self.is_connected else (Word.UNCONFIRMED, "heartbeat_lost")
        return Word.COMPLETED, None

    async def close(self) -> None:
        """Stop listening. Raises a listener's error."""
        if self._losing is not None:
            self._losing.cancel()
        for task in self._tasks:
            task.cancel()
        for ended in await asyncio.gather(*self._tasks, return_exceptions=True):
            if isinstance(ended, Exception):
                raise ended

    async def _put_back(self) -> None:
        """Restore the rate of EXTENDED_SYS_STATE in the vehicle's own stream set.

        MAVSDK's Action requests it at 1 Hz whenever a vehicle connects, which would change the set.
        """
        await self._ask("EXTENDED_SYS_STATE", lambda: self.telemetry.set_rate_landed_state(0.0))

    async def _put_back_again(self) -> None:
        try:
            await self._put_back()
        except MissionError as error:
            logger.warning("%s", error)

    async def _ask(self, what: str, ask: Callable[[], Coroutine[Any, Any, Answer]]) -> Answer:
        while True:
            try:
                return await self._calls.run(ask())
            except (TelemetryError, ActionError) as error:
                self.unanswered = f"{what}: {error.result.name.lower()}"
                if error.result not in _AGAIN:
                    raise MissionError(f"drone {self.number}: {self.unanswered}") from error

    def _listeners(self) -> list[Coroutine[Any, Any, None]]:
        telemetry = self.telemetry
        found = [
            _each(telemetry.subscribe_armed(), self._on_armed),
            _each(telemetry.subscribe_flight_mode(), self._on_mode),
            _each(telemetry.subscribe_position(), self._on_position),
            _each(self.system.is_connected_state(), self._on_connected),
        ]
        if self.view.tells_landed:
            found.append(_each(telemetry.subscribe_landed_state(), self._on_landed))
        return found

    def _on_armed(self, armed: bool) -> None:
        """MAVSDK reports `armed` with every heartbeat of the autopilot, changed or not."""
        now_s = self._clock()
        self.heartbeats.heard(now_s)
        before, self.view.armed = self.view.armed, TimedValue(armed, now_s)
        if before is None or before.value != armed:
            self._write("armed", {"armed": armed})
        self._tell()

    def _on_mode(self, mode: FlightMode) -> None:
        name = mode_of(mode)
        before, self.view.mode = self.view.mode, TimedValue(name, self._clock())
        if before is None or before.value != name:
            self._write("flight_mode", {"mode": name.label})
        self._tell()

    def _on_landed(self, state: LandedState) -> None:
        landed = landed_of(state)
        before, self.view.landed = self.view.landed, TimedValue(landed, self._clock())
        if before is None or before.value != landed:
            self._write("landed_state", {"landed": landed.label})
        self._tell()

    def _on_position(self, found: Position) -> None:
        now_s = self._clock()
        place = place_of(found)
        self.view.place = TimedValue(place, now_s)
        if now_s - self._logged_place_s >= LOCATION_LOG_S:
            self._logged_place_s = now_s
            self._write("location", asdict(place))
        self._tell()

    def _on_connected(self, connected: bool) -> None:
        self.is_connected = connected
        if self._losing is not None:
            self._losing.cancel()
            self._losing = None
        if connected:
            self.is_lost = False
            self._tasks.append(asyncio.create_task(self._put_back_again()))
        else:
            self._losing = asyncio.get_running_loop().call_later(LOST_S, self._lose)
        self._tell()

    def _lose(self) -> None:
        self.is_lost = True
        self._tell()

    def _write(self, name: str, value: dict[str, object]) -> None:
        self._log.write("state", drone=self.number, name=name, value=value, age_ms=None)

    def _tell(self) -> None:
        self._news.set()
        self._on_news()


async def _each(values: AsyncGenerator[Value, None], handle: Callable[[Value], None]) -> None:
    async with contextlib.aclosing(values):
        async for value in values:
            handle(value)
