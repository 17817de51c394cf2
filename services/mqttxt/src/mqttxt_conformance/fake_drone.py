"""The kit as a UAV client on the fog's broker, with a clock that is known exactly and answers that a check sets."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mqttxt.core.clock import SessionClock, stamp, system_clock_ns
from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import BeaconMessage, Presence, ResultMessage, Word
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import State
from mqttxt.protocol.topics import FogSide
from mqttxt.protocol.values import Encoding

from . import shapes
from .registry import Broken
from .tap import Heard, Line

QUESTION_HELD_S = 0.2
"""A simulated delay of a lease's nonce on its way to the drone; `held_ms` does not include it."""


@dataclass(frozen=True)
class Forwarded:
    """A command as it reached the drone, with the drone's clock at its arrival."""

    heard: Heard
    fields: dict[str, Any]
    now_ms: int


class FakeDrone:
    """One drone; its clock starts at `ahead_ms`."""

    def __init__(self, number: int, topics: FogSide, tap: Line, ahead_ms: int = 0) -> None:
        self.number = number
        self.session = secrets.randbelow(2**32 - 1) + 1
        self.words: tuple[Word, ...] = (Word.ACCEPTED, Word.COMPLETED)
        self.commands: list[Forwarded] = []
        self.leases: list[tuple[Heard, dict[str, Any]]] = []
        self.answers_leases = True
        self._topics = topics
        self._tap = tap
        start_ns = system_clock_ns() - ahead_ms * 1_000_000
        self._clock = SessionClock(_from(start_ns), self.session)
        self._tasks: set[asyncio.Task[None]] = set()

    def now_ms(self) -> int:
        return self._clock.now_ms()

    def born(self, up: bool = True) -> None:
        """Publish birth and first beacon, or if not `up` the will."""
        presence = Presence(session=self.session, up=up)
        self._tap.publish(self._topics.reachable(self.number), encode(presence), retain=True)
        if up:
            self.beacon()

    def beacon(self, nonce: int | None = None) -> None:
        held_ms = 0 if nonce is not None else None
        message = BeaconMessage(session=self.session, now_ms=self.now_ms(), nonce=nonce, held_ms=held_ms)
        self._tap.publish(self._topics.clock(self.number), encode(message), qos=0)

    def state(self, state: State, stamped_ms: int | None = None) -> int:
        """Publish a state; returns its stamp."""
        own = stamp(stamped_ms if stamped_ms is not None else self.now_ms())
        payload = encode_state(StampedState(state, own), Encoding.CBOR)
        self._tap.publish(self._topics.state(self.number, state.name), payload, qos=0)
        return own

    def say(self, gs_session: int, seq: int, command: str, word: Word, **more: Any) -> None:
        """Publish a word about a command."""
        own = stamp(self.now_ms())
        result = ResultMessage(gs_session=gs_session, seq=seq, session=self.session, stamp=own, word=word, **more)
        self._tap.publish(self._topics.commands_result(self.number, command), encode(result))

    def on_heard(self, heard: Heard) -> None:
        """Take leases and commands for this drone."""
        try:
            if heard.topic == self._topics.init_connect(self.number) and heard.payload:
                self._on_lease(heard, shapes.read("drone-lease", heard.payload))
            elif heard.topic == self._topics.commands(self.number) and heard.payload:
                self._on_command(heard, shapes.read("command", heard.payload))
        except Broken:
            return  # a rule checks the same message and reports it

    def _on_lease(self, heard: Heard, lease: dict[str, Any]) -> None:
        self.leases.append((heard, lease))
        if lease["drone_session"] == self.session and self.answers_leases:
            task = asyncio.create_task(self._echo(lease["nonce"]))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _echo(self, nonce: int) -> None:
        await asyncio.sleep(QUESTION_HELD_S)
        self.beacon(nonce)

    def _on_command(self, heard: Heard, fields: dict[str, Any]) -> None:
        self.commands.append(Forwarded(heard, fields, self.now_ms()))
        if fields["executor_session"] != self.session:
            return
        for word in self.words:
            self.say(fields["gs_session"], fields["seq"], fields["command"], word)


def _from(start_ns: int) -> Callable[[], int]:
    """A clock source that first reads `start_ns`, then the true time."""
    first = [start_ns]
    return lambda: first.pop() if first else system_clock_ns()
