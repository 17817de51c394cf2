"""The message set over MQTT-XT: a call returns at its first word; its last one is awaited before the next call."""

from __future__ import annotations

import asyncio
import logging

from mqttxt import Arm, Armed, Command, Drone, Land, MqttxtError, Offboard, StateUpdate, Stream, Takeoff, Velocity, Word

from .fleet import CommandResult, MissionError, StateValue
from .message_set import HOVER_M
from .mqttxt_fleet import FIVE_STATES, FIVE_STATES_HZ, MqttxtFleet, as_goto, plain
from .points import points_of

FIRST_WORD_LIMIT_S = 15.0
"""A command's deadline, 5 s, and the time that an outage may add: afterwards no first word is expected."""
LAST_WORD_LIMIT_S = 10.0
STREAM_TRIES = 3
OFFBOARD_S = 60.0
"""Longer than any call; resetting the drone ends the flight."""
logger = logging.getLogger("mission")


class MqttxtMessageFleet(MqttxtFleet):
    """One drone of one fog, for the message set."""

    tells_faster = False
    _following: asyncio.Task[None] | None = None
    _telling: asyncio.Task[None] | None = None

    @property
    def _number(self) -> int:
        return self.drones[0]

    async def close(self) -> None:
        try:
            await _end(self._following)
            await _end(self._telling)
        except MissionError as error:
            logger.warning("%s", error)
        await super().close()

    async def call(self, call: int, name: str) -> CommandResult:
        command = self._command(name)
        self._log.write("command", call=call, command=name, fog=self._fog_of(self._number).number, drone=self._number)
        first: asyncio.Future[CommandResult] = asyncio.get_running_loop().create_future()
        self._following = asyncio.create_task(self._follow_call(call, name, command, first))
        await asyncio.wait({first}, timeout=FIRST_WORD_LIMIT_S)
        if not first.done():
            first.set_result(self._own_word(call, name, Word.UNCONFIRMED, "no_word"))
        return first.result()

    async def settle(self) -> bool:
        """Wait for the last word of the last call, which ends because the drone was disarmed."""
        following, self._following = self._following, None
        if following is None:
            return True
        await asyncio.wait({following}, timeout=LAST_WORD_LIMIT_S)
        in_time = following.done()
        await _end(following)
        return in_time

    def follows(self, armed: bool) -> bool:
        """Only `armed` counts: the UAV client judges effects by messages after the acknowledgement, on the drone."""
        known = self._drone().state(Armed)
        return known is not None and known.state.armed == armed

    async def stop_fixed_rates(self) -> None:
        if self._at_fixed_rate:
            for name in FIVE_STATES:
                await self._ask_rate(name, 0.0)

    async def request_state(self, name: str) -> asyncio.Queue[StateValue]:
        await _end(self._telling)
        told: asyncio.Queue[StateValue] = asyncio.Queue()
        self._telling = asyncio.create_task(self._take(name, told))
        await self._ask_rate(name, FIVE_STATES_HZ)
        return told

    async def stop_state(self, name: str) -> None:
        await _end(self._telling)
        try:
            await self._ask_rate(name, 0.0)
        except MissionError as error:
            logger.warning("%s", error)

    def _command(self, name: str) -> Command:
        commands: dict[str, Command] = {
            "arm": Arm(),
            "takeoff": Takeoff(HOVER_M),
            "land": Land(),
            "offboard": Offboard(OFFBOARD_S, velocity=Velocity(0.0, 0.0, 0.0)),
            "goto": as_goto(points_of([self._number])[self._number]),
        }
        return commands[name]

    def _drone(self) -> Drone:
        return self._fog_of(self._number).drone(self._number)

    async def _follow_call(self, call: int, name: str, command: Command, first: asyncio.Future[CommandResult]) -> None:
        """Send a command and log its words up to the last; the first one is the result of `first`."""
        try:
            async for outcome in self._drone().send(command):
                self._note(call, outcome)
                if not first.done():
                    first.set_result(CommandResult(self._number, outcome.word.label, outcome.reason))
        except MqttxtError as error:
            logger.warning("call %d: %s", call, error)
        if not first.done():
            first.set_result(self._own_word(call, name, Word.UNREACHABLE, "not_sent"))

    def _own_word(self, call: int, name: str, word: Word, reason: str) -> CommandResult:
        """The ground station's own word about a call that got no word."""
        fog = self._fog_of(self._number).number
        self._log.outcome(call, name, fog, self._number, word, reason)
        return CommandResult(self._number, word.label, reason)

    async def _take(self, name: str, told: asyncio.Queue[StateValue]) -> None:
        async for event in self._station.events():
            if isinstance(event, StateUpdate) and event.drone == self._number and event.state.name == name:
                value = {field: plain(found) for field, found in vars(event.state).items()}
                told.put_nowait(StateValue(value, event.age_ms))

    async def _ask_rate(self, name: str, rate_hz: float) -> None:
        """Request a state at a rate, in up to three tries. Raises MissionError if it is refused or not completed."""
        said = ""
        try:
            for _ in range(STREAM_TRIES):
                last = await self._drone().send(Stream(name, rate_hz))
                if last.completed:
                    return
                said = last.word.label + (f" ({last.reason})" if last.reason else "")
                if last.word in (Word.DENIED, Word.UNSUPPORTED):
                    break
        except MqttxtError as error:
            raise MissionError(f"stream {name}: {error}") from error
        raise MissionError(f"stream {name}: {said}")


async def _end(task: asyncio.Task[None] | None) -> None:
    """Cancel a task. Raises its error, if it failed; one of the ground station's as MissionError."""
    if task is not None:
        task.cancel()
        await asyncio.wait({task})
        if not task.cancelled():
            try:
                task.result()
            except MqttxtError as error:
                raise MissionError(str(error)) from error
