"""Words of one broadcast that leave the activator together (docs/protocol.md, R10.6)."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.channel import Channel
from ..core.clock import stamp
from ..core.effects import Publish
from ..protocol.messages import MOST_TOGETHER, FogResultMessage, ResultMessage, Word, WordTogether
from ..protocol.topics import CloudSide
from ..security.cose import Envelope
from ..security.together import encode_together

WINDOW_MS = 50
"""How long a word waits at most: the answers of drones behind one mobile network differ by its jitter, there and back,
and nobody does anything else by a yes.
"""
LONGEST = 3000
"""Bytes of a word that leaves with others: as many as may leave together stay below the longest payload."""
PATIENT = frozenset({Word.ACCEPTED, Word.IN_PROGRESS, Word.COMPLETED})
"""The words that wait for others; by any other a station may do something else."""


@dataclass(frozen=True)
class _Waiting:
    """A word of a drone, and the message in which it would leave alone."""

    drone: int
    result: ResultMessage
    alone: Publish


class WordsTogether:
    """The words that wait, of one command and in their order. Whoever says anything else flushes them first."""

    def __init__(self, session: int, channel: Channel, cloud: CloudSide) -> None:
        self.due_ms: int | None = None
        """When those that wait leave."""
        self.is_ended = False
        """Nothing waits any more: the role stops."""
        self._session = session
        self._channel = channel
        self._cloud = cloud
        self._name = ""
        self._waiting: list[_Waiting] = []

    def add(self, name: str, drone: int, result: ResultMessage, alone: Publish, now_ms: int) -> list[Publish]:
        """A word about the broadcast of a command of this name: what leaves now."""
        if len(alone.payload) > LONGEST:
            return [*self.flush(now_ms), alone]
        out = self.flush(now_ms) if self._waiting and self._waiting[0].result.id != result.id else []
        if self.due_ms is None:
            self._name, self.due_ms = name, now_ms + WINDOW_MS
        self._waiting.append(_Waiting(drone, result, alone))
        waits = result.word in PATIENT and len(self._waiting) < MOST_TOGETHER and not self.is_ended
        return out if waits else [*out, *self.flush(now_ms)]

    def tick(self, now_ms: int) -> list[Publish]:
        """What has waited long enough."""
        return self.flush(now_ms) if self.due_ms is not None and now_ms >= self.due_ms else []

    def flush(self, now_ms: int) -> list[Publish]:
        """All that waits; one word by itself leaves as if it had never waited."""
        waiting, self._waiting, self.due_ms = self._waiting, [], None
        if len(waiting) < 2:
            return [word.alone for word in waiting]
        topic, qos = self._cloud.fog_result(self._name), self._channel.settings.qos
        if self._channel.seal is not None:
            signed = [(word.drone, Envelope.parse(word.alone.payload)) for word in waiting]
            return [Publish(self._channel.link, topic, encode_together(signed), qos)]
        words = tuple(WordTogether.of(word.drone, word.result) for word in waiting)
        of, session, now = waiting[0].result, self._session, stamp(now_ms)
        message = FogResultMessage(gs_session=of.gs_session, seq=of.seq, session=session, stamp=now, words=words)
        return [self._channel.publish(topic, message)]
