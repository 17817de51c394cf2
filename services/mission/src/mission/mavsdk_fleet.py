"""The fleet over MAVLink, with MAVSDK as the ground station: one call for each drone."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.exceptions import MavsdkConnectionError
from mavsdk.asyncio.system import System
from mavsdk.logging import LogLevel, log_subscribe, log_unsubscribe
from mavsdk.plugins.action import ActionError
from mavsdk.plugins.mission_raw import MissionRawError

from mqttxt import Word

from .events import EventLog
from .fleet import CommandResult, MissionError, Point, Reading, Status, Survey
from .mavsdk_calls import go_to, items_of, take_off
from .mavsdk_drone import Calls, MavsdkDrone
from .mavsdk_outcomes import (
    Goal,
    arm_goal,
    goto_goal,
    land_goal,
    refusal,
    return_goal,
    survey_goal,
    takeoff_goal,
    uploaded_goal,
)
from .options import COMMANDINGS, STREAMS
from .plain_readings import PlainReadings

LOOK_S = 0.1
"""The pause between two checks of MAVSDK's systems: it announces a new one, but not the autopilot that joins it."""
THREADS_PER_DRONE = 4
"""A call that is not answered keeps a thread for two or three seconds."""

Ask = Callable[[MavsdkDrone], Coroutine[Any, Any, object]]
logger = logging.getLogger("mavsdk")


@dataclass(frozen=True)
class _Accepted:
    """A call that the autopilot acknowledged."""

    call: int
    asked_s: float


class MavsdkFleet:
    """Drones by their MAVLink system ids, received at `urls` (`udpin://HOST:PORT`); `fogs` maps fogs to their drones.

    `commanding`: `one-by-one` makes the next call after the last one returned, as a plain MAVSDK script does;
    `concurrent` makes all at once. `streams` are the vehicles' messages: `px4-onboard` and `px4-gcs` are sent
    unasked, `five-states` are requested here. Sensors' readings, for which MAVLink has no messages, arrive at
    `sensor_broker`: empty, or mqtt://HOST[:PORT].
    """

    def __init__(
        self,
        urls: tuple[str, ...],
        fogs: dict[int, tuple[int, ...]],
        commanding: str,
        streams: str,
        log: EventLog,
        sensor_broker: str = "",
    ) -> None:
        for name, value, known in (("commanding", commanding, COMMANDINGS), ("streams", streams, STREAMS)):
            if value not in known:
                raise ValueError(f"{name} {value!r}: expected one of {', '.join(known)}")
        self._urls = urls
        self._fogs = fogs
        self._concurrent = commanding == "concurrent"
        self._streams = streams
        self._log = log
        self._mavsdk: Mavsdk | None = None
        self._drones: dict[int, MavsdkDrone] = {}
        self._others: set[int] = set()
        self._setting_up: set[asyncio.Task[None]] = set()
        self._calls = Calls()
        self._news = asyncio.Event()
        self._sensors = (
            PlainReadings(sensor_broker, tuple(fogs), self._on_reading, self._news.set) if sensor_broker else None
        )
        self._readings: list[Reading] = []

    @property
    def drones(self) -> tuple[int, ...]:
        return tuple(drone for drones in self._fogs.values() for drone in drones)

    async def connect(self, limit_s: float) -> None:
        """Wait until every drone is connected, set up and has sent its states. Raises MissionError."""
        asyncio.get_running_loop().set_default_executor(
            ThreadPoolExecutor(THREADS_PER_DRONE * max(1, len(self.drones)), "mavsdk")
        )
        log_subscribe(_to_logger)
        try:
            async with asyncio.timeout(limit_s):
                if self._sensors is not None:
                    await self._sensors.connect()
                await self._open()
                while self._missing():
                    await self._look()
                    await asyncio.sleep(LOOK_S)
        except TimeoutError:
            raise MissionError(f"connect: within {limit_s:g} s not there: {'; '.join(self._missing())}") from None

    async def close(self) -> None:
        """End every call, stop listening and release MAVSDK; takes at most the three seconds of an open call."""
        if self._sensors is not None:
            await self._sensors.close()
        for task in self._setting_up:
            task.cancel()
        await asyncio.gather(*self._setting_up, return_exceptions=True)
        for drone in self._drones.values():
            await drone.close()
        await self._calls.wait()
        mavsdk, self._mavsdk = self._mavsdk, None
        if mavsdk is not None:
            await asyncio.to_thread(mavsdk.destroy)
            log_unsubscribe()

    async def arm(self) -> list[CommandResult]:
        return await self._command("arm", lambda drone: drone.action.arm(), arm_goal())

    async def takeoff(self, altitude_m: float) -> list[CommandResult]:
        return await self._command("takeoff", lambda drone: take_off(drone, altitude_m), takeoff_goal(altitude_m))

    async def land(self) -> list[CommandResult]:
        return await self._command("land", lambda drone: drone.action.land(), land_goal())

    async def goto(self, points: Mapping[int, Point]) -> list[CommandResult]:
        goals = {drone: goto_goal(point) for drone, point in points.items()}
        return await self._command_each("goto", lambda drone: go_to(drone, points[drone.number]), goals)

    def within(self, limit_s: float) -> float:
        """MAVLink's commands have no limit, nor a last word that arrives later."""
        return limit_s

    async def goto_best(self, point: Point) -> CommandResult:
        """Raises MissionError: MAVLink has no choice among drones."""
        raise MissionError("goto_best: MAVLink has no choice among drones; expected the protocol mqttxt")

    async def return_home(self) -> list[CommandResult]:
        return await self._command("return", lambda drone: drone.action.return_to_launch(), return_goal())

    async def upload(self, surveys: Mapping[int, Survey]) -> list[CommandResult]:
        """Completed when the vehicle has acknowledged the mission: nothing is read back."""
        goals = dict.fromkeys(surveys, uploaded_goal())
        return await self._command_each(
            "upload_plan", lambda drone: drone.mission.upload_mission(items_of(surveys[drone.number])), goals
        )

    async def fly_survey(self) -> list[CommandResult]:
        return await self._command("start_mission", lambda drone: drone.mission.start_mission(), survey_goal())

    @property
    def readings(self) -> Sequence[Reading]:
        return self._readings

    def status(self, drone: int) -> Status:
        found = self._drones.get(drone)
        return found.view.status if found is not None else Status()

    async def changed(self) -> None:
        """Return when a message arrived since the last call. Raises MissionError if a drone is lost."""
        self._news.clear()
        self._check_lost()
        await self._news.wait()
        self._check_lost()

    def _on_reading(self, fog: int, reading: Reading) -> None:
        self._readings.append(reading)
        self._log.reading(fog, reading)
        self._news.set()

    async def _open(self) -> None:
        self._mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        for url in self._urls:
            try:
                await self._mavsdk.add_any_connection(url)
            except MavsdkConnectionError as error:
                raise MissionError(f"connect: {url}: {error}") from error

    async def _look(self) -> None:
        """Add the vehicles that appeared. Raises MissionError for two with one system id, or a refused set-up."""
        assert self._mavsdk is not None
        for system in await self._mavsdk.get_systems():
            number = await system.get_system_id()
            if number in self._drones or not await system.has_autopilot() or not await system.is_connected():
                continue
            if number in self.drones:
                self._add(number, system)
            else:
                self._others.add(number)
        for task in self._setting_up:
            if task.done() and (refused := task.exception()) is not None:
                raise MissionError(f"connect: {refused}") from refused
        for number, drone in self._drones.items():
            if drone.heartbeats.is_two:
                raise MissionError(
                    f"connect: drone {number}: heartbeats twice as often as one vehicle sends them: two vehicles have "
                    f"system id {number}, or one is heard over two ways"
                )

    def _add(self, number: int, system: System) -> None:
        fog = next(fog for fog, drones in self._fogs.items() if number in drones)
        drone = MavsdkDrone(number, fog, system, self._streams, self._log, self._calls, self._news.set)
        self._drones[number] = drone
        self._setting_up.add(asyncio.create_task(drone.set_up()))

    def _missing(self) -> list[str]:
        """The reasons why the fleet is not ready, empty when it is."""
        found = self._sensors.missing if self._sensors is not None else []
        heard = f" (heard system {', '.join(map(str, sorted(self._others)))})" if self._others else ""
        for number in self.drones:
            drone = self._drones.get(number)
            if drone is None:
                found.append(f"drone {number} never appeared{heard}")
            elif not drone.is_connected:
                found.append(f"drone {number} appeared, but its heartbeats stopped")
            elif not drone.is_set_up:
                found.append(f"drone {number} does not answer" + (f" ({drone.unanswered})" if drone.unanswered else ""))
            elif drone.view.missing:
                found.append(f"drone {number} has not told {', '.join(drone.view.missing)}")
            elif not drone.heartbeats.is_one:
                found.append(f"drone {number}: too few heartbeats to know that it is one vehicle")
        return found

    def _check_lost(self) -> None:
        lost = [f"drone {number}: heartbeats stopped" for number, drone in self._drones.items() if drone.is_lost]
        if self._sensors is not None and self._sensors.lost is not None:
            lost.append(str(self._sensors.lost))
        if lost:
            raise MissionError("; ".join(lost))

    async def _command(self, command: str, ask: Ask, goal: Goal) -> list[CommandResult]:
        """Make the same call for every drone."""
        return await self._command_each(command, ask, dict.fromkeys(self.drones, goal))

    async def _command_each(self, command: str, ask: Ask, goals: Mapping[int, Goal]) -> list[CommandResult]:
        """Call the drones of `goals`, one by one or at once as `commanding` has it; completions overlap."""
        async with asyncio.TaskGroup() as group:
            flown = []
            for number, goal in goals.items():
                drone, acknowledged = self._drones[number], asyncio.Event()
                flight = group.create_task(self._fly(drone, command, ask, goal, acknowledged))
                flown.append(flight)
                if not self._concurrent:
                    await acknowledged.wait()
        return [flight.result() for flight in flown]

    async def _fly(
        self, drone: MavsdkDrone, command: str, ask: Ask, goal: Goal, acknowledged: asyncio.Event
    ) -> CommandResult:
        """Carry a command from its call to its last word; `acknowledged` is set when the call has returned."""
        accepted = await self._call(drone, command, ask)
        acknowledged.set()
        if isinstance(accepted, CommandResult):
            return accepted
        word, reason = await drone.settle(goal, accepted.asked_s)
        return self._note(accepted.call, command, drone, word, reason)

    async def _call(self, drone: MavsdkDrone, command: str, ask: Ask) -> _Accepted | CommandResult:
        return await self._call_as(self._log.next_call(), drone, command, ask)

    async def _call_as(self, call: int, drone: MavsdkDrone, command: str, ask: Ask) -> _Accepted | CommandResult:
        """Make a call under a given number."""
        asked_s = asyncio.get_running_loop().time()
        self._log.write("command", call=call, command=command, fog=drone.fog, drone=drone.number)
        try:
            await self._calls.run(ask(drone))
        except (ActionError, MissionRawError) as error:
            return self._note(call, command, drone, *refusal(error.result))
        self._note(call, command, drone, Word.ACCEPTED, None)
        return _Accepted(call, asked_s)

    def _note(self, call: int, command: str, drone: MavsdkDrone, word: Word, reason: str | None) -> CommandResult:
        self._log.outcome(call, command, drone.fog, drone.number, word, reason)
        return CommandResult(drone.number, word.label, reason)


def _to_logger(level: LogLevel, message: str, file: str | None, line: int) -> bool:
    """Pass MAVSDK's log to Python's; returns True, so that MAVSDK does not print it."""
    logger.log(logging.WARNING if level >= LogLevel.ERROR else logging.DEBUG, "%s", message)
    return True
