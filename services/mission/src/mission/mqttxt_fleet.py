"""The fleet over MQTT-XT: a command for all drones is one broadcast per fog.

States are published `on-change`, by the protocol's policies; `fixed`: the five states at 1 Hz, each on its topic; or
`bundle`: the same in one message per fog. Other states that a mission needs are always published on change.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterable, Callable, Coroutine, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from mqttxt import (
    Arm,
    Armed,
    Command,
    FlightMode,
    Fog,
    Goto,
    GroundStation,
    Land,
    LandedState,
    MqttxtError,
    Outcome,
    Plan,
    Return,
    SensorReading,
    StartMission,
    StateUpdate,
    Stream,
    Takeoff,
    UploadPlan,
)
from mqttxt.protocol.plans import PlanItem, PlanObject

from .events import EventLog
from .fleet import CommandResult, MissionError, Point, Reading, Status, Survey

TTL_S = 30.0
"""The time within which a command must start: no step of a mission is urgent, and over a lossy satellite link a command
may need ten seconds and more."""
LAST_WORD_S = 15.0
"""Time after deadline and limit: a station's library closes a command after 10 s (R5.9); the rest is for its word."""
FIVE_STATES = ("battery", "location", "groundspeed", "flight_mode", "heading")
FIVE_STATES_HZ = 1.0
NEEDED_STATES = frozenset({"armed", "flight_mode", "landed_state", "location"})
NAV_WAYPOINT, NAV_RETURN, NAV_TAKEOFF = 16, 20, 22
FRAME_MISSION, FRAME_RELATIVE = 2, 3
"""MAV_CMDs, and MAV_FRAMEs: without a position, and relative to home."""
logger = logging.getLogger("mission")


class MqttxtFleet:
    """Drones of one or more fogs at a cloud broker. `fogs` maps each fog to its drones.

    `states` is `on-change`, `fixed` or `bundle`. Without an `identity` nothing is encrypted.
    Raises mqttxt.ConfigurationError for an invalid setting.
    """

    def __init__(
        self,
        cloud: str,
        fogs: dict[int, tuple[int, ...]],
        qos: int,
        log: EventLog,
        states: str = "on-change",
        identity: Path | None = None,
        signed: bool = False,
    ) -> None:
        insecure = identity is None
        self._station = GroundStation(
            cloud, qos=qos, bundles=states == "bundle", identity=identity, signed=signed, insecure=insecure
        )
        self._limit_s: float | None = None
        self._at_fixed_rate = states in ("fixed", "bundle")
        self._wanted = fogs
        self._log = log
        self._fogs: dict[int, Fog] = {}
        self._readings: list[Reading] = []
        self._plans: dict[int, Plan] = {}
        self._heard = asyncio.Event()
        self._listening: asyncio.Task[None] | None = None
        self._lost: BaseException | None = None
        self._stack = contextlib.AsyncExitStack()

    @property
    def drones(self) -> tuple[int, ...]:
        return tuple(drone for drones in self._wanted.values() for drone in drones)

    async def connect(self, limit_s: float) -> None:
        """Register at every fog, and wait for every drone and its states. Raises MissionError, also at `limit_s`."""
        try:
            await self._stack.enter_async_context(self._station)
            self._listening = asyncio.create_task(self._listen())
            self._listening.add_done_callback(self._hears_no_more)
            connected = await self._station.connect(self._wanted, limit_s)
            self._fogs = {fog.number: fog for fog in connected}
            await self._station.wait_until(lambda: not self._missing(), limit_s)
            if self._at_fixed_rate:
                asked = [self._stream(fog, name) for fog in connected for name in FIVE_STATES]
                await asyncio.gather(*asked)
        except MqttxtError as error:
            raise MissionError(f"connect: {error}") from error
        except TimeoutError:
            raise MissionError(f"connect: within {limit_s:g} s not there: {'; '.join(self._missing())}") from None

    async def close(self) -> None:
        """Disconnect from the broker. An error of the station is only logged: the mission reports it."""
        if self._listening is not None:
            self._listening.cancel()
        try:
            await self._stack.aclose()
        except MqttxtError as error:
            logger.warning("the ground station ended: %s", error)

    def within(self, limit_s: float) -> float:
        """The limit counts from a command's start, which the deadline bounds."""
        self._limit_s = limit_s
        return TTL_S + limit_s + LAST_WORD_S

    async def arm(self) -> list[CommandResult]:
        return await self._broadcast(Arm())

    async def takeoff(self, altitude_m: float) -> list[CommandResult]:
        return await self._broadcast(Takeoff(altitude_m))

    async def land(self) -> list[CommandResult]:
        return await self._broadcast(Land())

    async def goto(self, points: Mapping[int, Point]) -> list[CommandResult]:
        """Send each drone a command of its own, all at once."""
        asked = [self._to_drone(drone, as_goto(point)) for drone, point in points.items()]
        return await self._all("goto", asked)

    async def goto_best(self, point: Point) -> CommandResult:
        """Send the drone that arrives first, by the fogs' lists of arrival times, which are logged as `psmi` events."""
        call = self._log.next_call()
        self._log.write("command", call=call, command=Goto.name, fog=None, drone=None)
        try:
            sent = self._station.best(as_goto(point), list(self._wanted))
            async for event in sent:
                if isinstance(event, Outcome):
                    self._note(call, event)
                else:
                    listed = [candidate.drone for candidate in event.listed]
                    self._log.write("psmi", call=call, fog=event.fog, drones=listed, chosen=event.chosen)
            last = await sent
        except MqttxtError as error:
            raise MissionError(f"goto_best: {error}") from error
        if last.drone is None:
            raise MissionError(f"goto_best: {last.word.label} ({last.reason})")
        return CommandResult(last.drone, last.word.label, last.reason)

    async def return_home(self) -> list[CommandResult]:
        return await self._broadcast(Return())

    async def upload(self, surveys: Mapping[int, Survey]) -> list[CommandResult]:
        """Upload to all drones at once; completed when the plan read back from each autopilot is its survey."""
        self._plans = {drone: plan_of(survey) for drone, survey in surveys.items()}
        return await self._all("upload", [self._upload(drone, plan) for drone, plan in self._plans.items()])

    async def fly_survey(self) -> list[CommandResult]:
        """Start all surveys at once."""
        asked = [self._to_drone(drone, StartMission(plan.mission_hash)) for drone, plan in self._plans.items()]
        return await self._all("survey", asked)

    @property
    def readings(self) -> Sequence[Reading]:
        return self._readings

    def status(self, drone: int) -> Status:
        seen = self._fog_of(drone).drone(drone)
        armed, mode, landed = seen.state(Armed), seen.state(FlightMode), seen.state(LandedState)
        return Status(
            armed=armed.state.armed if armed else None,
            mode=mode.state.mode.label if mode else None,
            altitude_m=seen.location.state.altitude_m if seen.location else None,
            landed=landed.state.landed.label if landed else None,
        )

    async def changed(self) -> None:
        """Return when a message arrived since the last call. Raises MissionError if the broker refuses."""
        self._heard.clear()
        if self._lost is None:
            await self._heard.wait()
        if self._lost is not None:
            raise MissionError(str(self._lost)) from self._lost

    async def _broadcast(self, command: Command) -> list[CommandResult]:
        return await self._all(command.name, [self._to_fog(fog, command) for fog in self._fogs.values()])

    async def _all(self, name: str, asked: list[Coroutine[Any, Any, list[CommandResult]]]) -> list[CommandResult]:
        try:
            parts = await asyncio.gather(*asked)
        except MqttxtError as error:
            raise MissionError(f"{name}: {error}") from error
        return [result for part in parts for result in part]

    async def _stream(self, fog: Fog, name: str) -> None:
        """Request a state at its fixed rate, as set-up: it is not logged as a call of the mission."""
        answers = {outcome.drone: outcome for outcome in await fog.broadcast(Stream(name, FIVE_STATES_HZ))}
        wanted = self._wanted[fog.number]
        for drone in wanted:
            if drone in answers and not answers[drone].completed:
                refused = CommandResult(drone, answers[drone].word.label, answers[drone].reason)
                raise MissionError(f"connect: stream {name}: {refused}")
        if silent := set(wanted) - answers.keys():
            raise MissionError(f"connect: stream {name}: drone {min(silent)}: no answer")

    async def _to_fog(self, fog: Fog, command: Command) -> list[CommandResult]:
        return await self._follow(fog, None, command, fog.broadcast)

    async def _to_drone(self, drone: int, command: Command) -> list[CommandResult]:
        fog = self._fog_of(drone)
        return await self._follow(fog, drone, command, fog.drone(drone).send)

    async def _upload(self, drone: int, plan: Plan) -> list[CommandResult]:
        """Upload a plan, and wait for the drone's last word."""
        call, fog = self._log.next_call(), self._fog_of(drone)
        self._log.write("command", call=call, command=UploadPlan.name, fog=fog.number, drone=drone)
        outcome = await fog.drone(drone).upload(plan)
        self._note(call, outcome)
        return [CommandResult(drone, outcome.word.label, outcome.reason)]

    async def _follow(
        self, fog: Fog, drone: int | None, command: Command, send: Callable[..., AsyncIterable[Outcome]]
    ) -> list[CommandResult]:
        """Make a call and log its words. `drone` None means all of the fog; a last word without a drone is for all."""
        call = self._log.next_call()
        self._log.write("command", call=call, command=command.name, fog=fog.number, drone=drone)
        wanted, results = self._wanted[fog.number], dict[int, CommandResult]()
        limit_s = command.limit_s if self._limit_s is None else min(self._limit_s, command.limit_s)
        async for outcome in send(command, ttl_s=TTL_S, limit_s=limit_s):
            self._note(call, outcome)
            if outcome.is_last:
                for one in wanted if outcome.drone is None else (outcome.drone,):
                    results.setdefault(one, CommandResult(one, outcome.word.label, outcome.reason))
        return [result for one, result in results.items() if one in wanted]

    def _note(self, call: int, outcome: Outcome) -> None:
        self._log.outcome(
            call,
            command=outcome.command,
            fog=outcome.fog,
            drone=outcome.drone,
            word=outcome.word,
            reason=outcome.reason,
            command_id=str(outcome.id),
            settled=outcome.settled,
        )

    async def _listen(self) -> None:
        async for event in self._station.events():
            if isinstance(event, StateUpdate):
                value = {name: plain(found) for name, found in vars(event.state).items()}
                self._log.write("state", drone=event.drone, name=event.state.name, value=value, age_ms=event.age_ms)
            elif isinstance(event, SensorReading):
                reading = Reading(**{field.name: getattr(event, field.name) for field in fields(Reading)})
                self._readings.append(reading)
                self._log.reading(event.fog, reading)
            self._heard.set()

    def _hears_no_more(self, listening: asyncio.Task[None]) -> None:
        self._lost = None if listening.cancelled() else listening.exception()
        self._heard.set()

    def _missing(self) -> list[str]:
        """The reasons why drones are not ready, empty when they are."""
        found = []
        for number, drones in self._wanted.items():
            for drone in drones:
                seen = self._fogs[number].drone(drone)
                if not seen.is_reachable:
                    found.append(f"drone {drone} is not reachable")
                elif unknown := NEEDED_STATES - set(seen.states):
                    found.append(f"drone {drone} has not told {', '.join(sorted(unknown))}")
        return found

    def _fog_of(self, drone: int) -> Fog:
        return next(self._fogs[number] for number, drones in self._wanted.items() if drone in drones)


def as_goto(point: Point) -> Goto:
    """The command that sends a drone to a point."""
    return Goto(point.latitude_deg, point.longitude_deg, point.altitude_m)


def plan_of(survey: Survey) -> Plan:
    """The plan with a survey as its mission."""
    first, *_ = survey.points
    there = [(NAV_TAKEOFF, first), *((NAV_WAYPOINT, point) for point in survey.points)]
    items = [_item(command, point) for command, point in there]
    back = PlanItem(FRAME_MISSION, NAV_RETURN, (0.0, 0.0, 0.0, 0.0), 0, 0, 0.0, True)
    return Plan(PlanObject(mission=(*items, back)))


def _item(command: int, point: Point) -> PlanItem:
    """An item at a point above home; its heading is not set."""
    return PlanItem(
        frame=FRAME_RELATIVE,
        command=command,
        params=(0.0, 0.0, 0.0, None),
        x=round(point.latitude_deg * 1e7),
        y=round(point.longitude_deg * 1e7),
        z=point.altitude_m,
        autocontinue=True,
    )


def plain(value: object) -> object:
    """A field of a state in the form of the events: an enumeration as its label, bytes in hexadecimal."""
    if isinstance(value, bytes):
        return value.hex()
    label = getattr(value, "label", None)
    return label if label is not None else value
