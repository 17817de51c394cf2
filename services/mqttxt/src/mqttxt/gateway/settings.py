"""PARAM_SET of clients, answered only by the value that the drone has read back (docs/gateway.md)."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ..drone.mavlink.autopilot import Autopilot
from ..drone.mavlink.parameter_protocol import parameter_of
from ..errors import BrokerRefused, ConfigurationError, FogUnreachable, PayloadError, StationEnded
from ..protocol.messages import Word
from ..protocol.parameters import Parameter
from ..protocol.states import Severity
from ..station.outcomes import Outcome
from ..station.views import Drone
from .client_commands import REPEAT_MS
from .clients import Client
from .parameter_copies import HIGHEST_M, LOWEST_M, TAKEOFF_ALTITUDE, ParameterCopies
from .texts import send_text
from .translation import NOT_NOW, Declined
from .work import Work, Worker

MOST_OPEN = 64
"""The most settings under way at a time; further ones are dropped, and clients send them again."""
NOT_THERE, WRONG_VALUE, NOT_ALLOWED = (
    int(mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST),
    int(mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE),
    int(mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED),
)
_ERRORS: Final = {
    "unknown_parameter": NOT_THERE,
    "wrong_value": WRONG_VALUE,
    "out_of_range": WRONG_VALUE,
    "not_carried": WRONG_VALUE,
}
"""PARAM_ERROR by the reason of a `denied`; any other is NOT_ALLOWED."""


@dataclass
class Setting:
    """A PARAM_SET of a client; `answer` and `ended_ms` are set at its end. `place`: its number among those sent."""

    client: Client
    drone: int
    wanted: Parameter
    asked_ms: int
    answer: Any | None = None
    ended_ms: int | None = None
    place: int = 0

    def is_repeated(self, now_ms: int) -> bool:
        """Whether an equal PARAM_SET now is a repetition of this one: clients repeat it until it is answered."""
        return self.ended_ms is None or now_ms - self.ended_ms <= REPEAT_MS


class ClientSettings(Worker):
    """The settings of all clients, each followed by a task; `send_to_all` sends to all that see a drone."""

    def __init__(self, work: Work, copies: ParameterCopies, send_to_all: Callable[[int, list[Any]], None]) -> None:
        super().__init__(work)
        self._copies = copies
        self._send_to_all = send_to_all
        self._newest: dict[tuple[Client, int, str], Setting] = {}
        self._completed: dict[tuple[int, str], int] = {}
        self._sent = 0
        self._open = Counter[bool]()
        self._turns: dict[int, asyncio.Lock] = {}

    def on_set(self, client: Client, drone: Drone, autopilot: Autopilot, message: Any) -> None:
        """Handle PARAM_SET."""
        name, wanted = str(message.param_id), parameter_of(message, autopilot.bytewise)
        if wanted is None or wanted.value is None:
            self._refuse(client, drone.number, name, WRONG_VALUE, "expected a number that its type has")
        else:
            self._set(Setting(client, drone.number, wanted, self._now_ms()), drone, autopilot)

    def tick(self, now_ms: int) -> None:
        """Forget the settings that ended long ago."""
        self._newest = {key: one for key, one in self._newest.items() if one.is_repeated(now_ms)}

    def _set(self, setting: Setting, drone: Drone, autopilot: Autopilot) -> None:
        key = (setting.client, setting.drone, setting.wanted.name)
        newest = self._newest.get(key) if setting.wanted.name != TAKEOFF_ALTITUDE else None
        if newest is not None and newest.wanted == setting.wanted and newest.is_repeated(setting.asked_ms):
            if newest.answer is not None:
                newest.client.peer.send(newest.drone, newest.answer)
        elif self._open[is_known := self._control.knows(setting.client)] < MOST_OPEN:
            self._open[is_known] += 1
            self._newest[key] = setting
            task = self._group.create_task(self._carry_out(setting, drone, autopilot))
            task.add_done_callback(lambda _: self._open.subtract((is_known,)))

    async def _carry_out(self, setting: Setting, drone: Drone, autopilot: Autopilot) -> None:
        try:
            if setting.wanted.name == TAKEOFF_ALTITUDE:
                await self._set_own(setting, drone, autopilot)
            else:
                self._hear(setting, await self._last_word(setting, drone), autopilot)
        except Declined as declined:
            self._end(setting, None if declined.result == NOT_NOW else NOT_ALLOWED, str(declined))
        except ConfigurationError as error:
            self._end(setting, NOT_ALLOWED, str(error))
        except PayloadError as error:
            self._end(setting, WRONG_VALUE, str(error))
        except FogUnreachable as error:
            self._end(setting, None, str(error))
        except (StationEnded, BrokerRefused):
            pass  # the outcome is unknown; the client's own time-out says so
        finally:
            setting.ended_ms = self._now_ms()

    async def _set_own(self, setting: Setting, drone: Drone, autopilot: Autopilot) -> None:
        """Set the gateway's own parameter, and show it to all who have the drone's list. Raises Declined."""
        await self._control.heard(setting.client)
        self._control.check(setting.client, drone)
        assert setting.wanted.value is not None
        if not self._copies.set_takeoff(drone.number, setting.wanted.value):
            self._end(setting, WRONG_VALUE, f"expected {LOWEST_M:g} to {HIGHEST_M:g} metres above home")
            return
        value = self._copies.message(drone.number, autopilot, self._copies.own(drone.number))
        if self._copies.last(drone.number) is None:  # its place is not known, which confuses who waits for the list
            setting.client.peer.send(drone.number, value)
        else:
            self._send_to_all(drone.number, [value])

    async def _last_word(self, setting: Setting, drone: Drone) -> Outcome:
        """Send a setting once the client has control; returns the last word. Raises Declined, and as `Drone.send`."""
        await self._control.heard(setting.client)
        async with self._turns.setdefault(drone.number, asyncio.Lock()):
            self._control.check(setting.client, drone, setting.asked_ms)
            await self._control.take(setting.client, drone, self._left_s(setting.asked_ms))
            assert setting.wanted.value is not None
            self._sent += 1
            setting.place = self._sent
            sent = drone.set_parameter(setting.wanted.name, setting.wanted.value, ttl_s=self._left_s(setting.asked_ms))
        return await sent

    def _hear(self, setting: Setting, last: Outcome, autopilot: Autopilot) -> None:
        if last.completed:
            key = (setting.drone, setting.wanted.name)
            if setting.place < self._completed.get(key, 0):  # its last word arrived after that of a later value
                self._end(setting, None, "a later value was set")
                return
            self._completed[key] = setting.place
            self._copies.fold(setting.drone, setting.wanted)
            setting.answer = self._copies.message(setting.drone, autopilot, setting.wanted)
            setting.client.peer.send(setting.drone, setting.answer)
            return
        reason = (last.reason or "").partition(",")[0]
        error = _ERRORS.get(reason, NOT_ALLOWED) if last.word is Word.DENIED else None
        if last.word in (Word.UNCONFIRMED, Word.FAILED):
            self._copies.forget(setting.drone)
        self._end(setting, error, str(last).partition(f"{last.command} ")[2])

    def _end(self, setting: Setting, error: int | None, why: str) -> None:
        """Answer a definite no with PARAM_ERROR, an unknown outcome or one to be tried again with a text alone."""
        setting.answer = self._refuse(setting.client, setting.drone, setting.wanted.name, error, why)

    def _refuse(self, client: Client, drone: int, name: str, error: int | None, why: str) -> Any | None:
        send_text(client.peer, drone, Severity.WARNING, f"{name} not set: {why}")
        if error is None:
            return None
        answer = error_message(client, name, -1, error)
        client.peer.send(drone, answer)
        return answer


def error_message(client: Client, name: str, place: int, error: int) -> Any:
    """PARAM_ERROR."""
    return mavlink.MAVLink_param_error_message(client.system, client.component, name.encode(), place, error)
