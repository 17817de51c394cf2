"""Words of one broadcast that the activator publishes together (docs/protocol.md, R10.6)."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.channel import Channel
from ..core.clock import stamp
from ..core.effects import Publish
from ..core.settings import TOGETHER_MS
from ..protocol.messages import (
    MOST_TOGETHER,
    CommandId,
    FogResultMessage,
    ResultMessage,
    RosterEntry,
    Word,
    WordTogether,
)
from ..protocol.topics import CloudSide
from ..security.cose import Envelope
from ..security.together import encode_together

LONGEST = 3000
"""The most bytes of a word that is sent with others: MOST_TOGETHER of them stay below the longest payload."""
PATIENT = frozenset({Word.ACCEPTED, Word.IN_PROGRESS, Word.COMPLETED})
"""The words that wait for others; a station may act on any other word."""


@dataclass(frozen=True)
class _Waiting:
    """A word of a drone, and the message that would carry it alone."""

    drone: int
    result: ResultMessage
    alone: Publish


@dataclass(frozen=True)
class _Roster:
    """A broadcast's roster, and the message that would carry it alone."""

    entries: tuple[RosterEntry, ...]
    alone: Publish


class WordsTogether:
    """The waiting roster and words of one command, in their order.

    Call `flush` before you publish anything else about a command. Methods return the messages to send now.
    """

    def __init__(self, session: int, channel: Channel, cloud: CloudSide) -> None:
        self.due_ms: int | None = None
        """When the waiting messages are sent; None if none wait."""
        self.is_ended = False
        """Whether the role stops, so that nothing waits any more."""
        self._session = session
        self._channel = channel
        self._cloud = cloud
        self._name = ""
        self._id: CommandId | None = None
        self._roster: _Roster | None = None
        self._waiting: list[_Waiting] = []

    def open(
        self, name: str, command_id: CommandId, roster: tuple[RosterEntry, ...], alone: Publish, now_ms: int
    ) -> list[Publish]:
        """Add the roster of a broadcast; `name` is the command's, `alone` the message that would carry it alone."""
        out = self.flush(now_ms)
        if not roster or len(roster) > MOST_TOGETHER or self._channel.seal is not None or self.is_ended:
            return [*out, alone]
        self._begin(name, command_id, now_ms)
        self._roster = _Roster(roster, alone)
        return out

    def add(self, name: str, drone: int, result: ResultMessage, alone: Publish, now_ms: int) -> list[Publish]:
        """Add a word about a broadcast; `name` is the command's, `alone` the message that would carry it alone."""
        if len(alone.payload) > LONGEST:
            return [*self.flush(now_ms), alone]
        out = self.flush(now_ms) if self._id not in (None, result.id) else []
        self._begin(name, result.id, now_ms)
        self._waiting = [word for word in self._waiting if word.drone != drone or not _is_replaced(word.result)]
        self._waiting.append(_Waiting(drone, result, alone))
        waits = result.word in PATIENT and len(self._waiting) < MOST_TOGETHER and not self.is_ended
        return out if waits else [*out, *self.flush(now_ms)]

    def waits(self, drone: int) -> bool:
        """Whether a word of this drone waits."""
        return any(word.drone == drone for word in self._waiting)

    def tick(self, now_ms: int) -> list[Publish]:
        """Send what has waited long enough."""
        return self.flush(now_ms) if self.due_ms is not None and now_ms >= self.due_ms else []

    def flush(self, now_ms: int) -> list[Publish]:
        """Send all that waits; a single roster or word is sent as if it had never waited."""
        waiting, self._waiting, self.due_ms = self._waiting, [], None
        roster, self._roster = self._roster, None
        command_id, self._id = self._id, None
        if roster is None and len(waiting) < 2:
            return [word.alone for word in waiting]
        if roster is not None and not waiting:
            return [roster.alone]
        assert command_id is not None
        topic, qos = self._cloud.fog_result(self._name), self._channel.settings.qos
        if self._channel.seal is not None:
            signed = [(word.drone, Envelope.parse(word.alone.payload)) for word in waiting]
            return [Publish(self._channel.link, topic, encode_together(signed), qos)]
        message = FogResultMessage(
            gs_session=command_id.gs_session,
            seq=command_id.seq,
            session=self._session,
            stamp=stamp(now_ms),
            roster=roster.entries if roster is not None else None,
            words=tuple(WordTogether.of(word.drone, word.result) for word in waiting),
        )
        return [self._channel.publish(topic, message)]

    def _begin(self, name: str, command_id: CommandId, now_ms: int) -> None:
        if self._id is None:
            self._name, self._id, self.due_ms = name, command_id, now_ms + TOGETHER_MS


def _is_replaced(word: ResultMessage) -> bool:
    """Whether a newer word of its drone replaces it: it says no more than that the command was begun."""
    return not word.word.is_last and word.late_ms is None
