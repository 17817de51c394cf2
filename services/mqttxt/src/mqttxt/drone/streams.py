"""States at a requested rate, and any MAVLink message as a state (docs/protocol.md, sections 3 and 5).

The autopilot is asked for a rate only if its own stream is slower, and never slowed down below its earlier rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..protocol.commands import Stream
from ..protocol.mavlink_states import kind_of, kinds, state_of
from ..protocol.states import STATES, AutopilotText, State
from ..protocol.topics import MAVLINK_STATE
from .mavlink.plans import CannotExecute, CommandPlan, command_long
from .mavlink.vehicle import SOURCES, Vehicle

ENOUGH = 0.8
"""The share of the requested rate that is good enough: rates are measured, and waver."""
REMINDER_MS = 10_000
"""The interval at which rates below half of the requested ones are requested again."""


@dataclass
class Turn:
    """When a state is published next."""

    interval_ms: float
    next_ms: float

    def is_due(self, now_ms: int) -> bool:
        """Whether it is time, and schedule the next. A quarter interval early counts; missed turns are dropped."""
        if now_ms < self.next_ms - self.interval_ms / 4:
            return False
        late = now_ms >= self.next_ms + self.interval_ms
        self.next_ms = (now_ms if late else self.next_ms) + self.interval_ms
        return True


class Streams:
    """The rates in force in one UAV client session, and the rates requested of the autopilot for them."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.names: frozenset[str] = frozenset()
        """The states that are published at a requested rate."""
        self.client_hz: dict[str, float] = {}
        """The rates that the UAV client asks for itself, by the kind of message: none is given up with a stream."""
        self._turns: dict[str, Turn] = {}
        self._by_kind: dict[str, list[str]] = {}
        self._asked_hz: dict[str, float] = {}
        self._default_hz: dict[str, float] = {}
        self._next_reminder_ms = 0

    def waits(self, name: str, bundle_ms: int) -> bool:
        """Whether a state is slow enough to wait for bundles every `bundle_ms`; a MAVLink message never waits."""
        return not name.startswith(MAVLINK_STATE) and self._turns[name].interval_ms >= bundle_ms

    def plan(self, command: Stream, now_ms: int) -> CommandPlan:
        """The plan that sets a rate. Raises CannotExecute for a state or a message that does not exist."""
        kind = source_of(command.state)
        message, ask = None, None
        if kind is not None:
            wanted_hz = self._wanted_hz(kind, command)
            ask = self._question(kind, wanted_hz, now_ms)
            message = None if ask is None else self._interval(kind, ask)
        return CommandPlan(
            message=message,
            mav_cmd=mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
            group=("stream", command.state),
            effect=partial(_shows, kind if command.rate_hz else None),
            on_accepted=partial(self._take, command, kind, ask),
        )

    def drop(self, name: str) -> None:
        """Publish a state by its policy again; the autopilot keeps the rate that was requested."""
        if self._turns.pop(name, None) is not None:
            self._index()

    def on_message(self, message: Any, now_ms: int) -> list[State]:
        """The states to publish after a message, by which the vehicle was updated before: those it had a value of."""
        kind = message.get_type()
        names = self._by_kind.get(kind)
        if names is None or not self._vehicle.is_own(message):
            return []
        states, number = self._vehicle.states, self._vehicle.number
        told = {name for name in names if name in states and states[name].number == number}
        carried = [name for name in names if name in told or name.startswith(MAVLINK_STATE)]
        due = [name for name in carried if self._turns[name].is_due(now_ms)]
        raw = [state_of(message) for name in due if name.startswith(MAVLINK_STATE)]
        vital = [states[name].state for name in due if name in told]
        return [*raw, *vital]

    def reminders(self, now_ms: int) -> list[Any]:
        """New requests for rates below half of the requested ones, as after a restart."""
        if now_ms < self._next_reminder_ms or not self._vehicle.is_alive(now_ms):
            return []
        self._next_reminder_ms = now_ms + REMINDER_MS
        asked = self._asked_hz.items()
        return [self._interval(kind, hz) for kind, hz in asked if self._vehicle.arrivals.rate_hz(kind, now_ms) < hz / 2]

    def due(self, now_ms: int) -> list[str]:
        """The due states that no message carries."""
        return [name for name in self._by_kind.get("", ()) if self._turns[name].is_due(now_ms)]

    def _take(self, command: Stream, kind: str | None, ask: float | None, now_ms: int) -> None:
        """A rate is in force from now on."""
        if kind is not None and ask is not None:
            self._asked_hz[kind] = ask
            self._next_reminder_ms = now_ms + REMINDER_MS
            if ask == 0:
                del self._asked_hz[kind]
        if command.rate_hz:
            self._turns[command.state] = Turn(1000 / command.rate_hz, now_ms)
        else:
            self._turns.pop(command.state, None)
        self._index()

    def _index(self) -> None:
        self.names = frozenset(self._turns)
        self._by_kind = {}
        for name in self._turns:
            self._by_kind.setdefault(source_of(name) or "", []).append(name)

    def _wanted_hz(self, kind: str, command: Stream) -> float:
        """The fastest rate that anybody wants of a message, once the command is in force."""
        others = (name for name in self._by_kind.get(kind, ()) if name != command.state)
        return max([command.rate_hz, *(1000 / self._turns[name].interval_ms for name in others)])

    def _question(self, kind: str, wanted_hz: float, now_ms: int) -> float | None:
        """The rate to request of the autopilot: 0 is its own, None if no request is needed."""
        if kind not in self._asked_hz:
            own_hz = self._vehicle.arrivals.rate_hz(kind, now_ms)
            if own_hz >= ENOUGH * wanted_hz:
                return None
            self._default_hz[kind] = own_hz
            return wanted_hz
        if ENOUGH * wanted_hz <= self._default_hz[kind]:
            own_hz = self.client_hz.get(kind, 0.0)
            wanted_hz = own_hz if own_hz >= ENOUGH * self._default_hz[kind] else 0.0
        return None if wanted_hz == self._asked_hz[kind] else wanted_hz

    def _interval(self, kind: str, rate_hz: float) -> Any:
        """SET_MESSAGE_INTERVAL in microseconds; 0 is the autopilot's own rate."""
        interval_us = 1e6 / rate_hz if rate_hz else 0.0
        number = float(kinds()[kind].id)
        return command_long(self._vehicle, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, interval_us)


def source_of(name: str) -> str | None:
    """The MAVLink message that carries a state, None if none does.

    Raises CannotExecute for an unknown state, and for `text`, which has no rate.
    """
    kind = kind_of(name)
    if kind is not None:
        return str(kind.msgname)
    if name not in STATES or name == AutopilotText.name:
        raise CannotExecute("unknown_message" if name.startswith(MAVLINK_STATE) else "unknown_state")
    return SOURCES.get(name)


def _shows(kind: str | None, vehicle: Vehicle, after: int) -> bool:
    """Whether a message of the kind came after number `after`; true without a kind."""
    return kind is None or vehicle.arrivals.number_of(kind) > after
