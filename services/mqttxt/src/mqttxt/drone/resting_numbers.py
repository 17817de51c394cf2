"""Which MAV_CMD may be sent now: an acknowledgement names only the number and the component it answers, so no command
may wait when a late one arrives.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from enum import Enum, auto

from ..protocol.messages import CommandId
from .mavlink.sources import Source

STRAY_ACK_MS = 3000
"""How long a key rests while its acknowledgements may still be under way."""
SECOND_ACK_MS = 300
"""How long a key rests for a second acknowledgement; PX4 writes both at once. Less than the time between copies."""

AckKey = tuple[int, Source]
"""The fields that identify an acknowledgement: the MAV_CMD, and the component that sent it."""


class AnsweredWrite(Enum):
    """The write that an acknowledgement answers if no run waits for it: the client's own, another copy of a command
    that was answered or given up, or one that was already accepted.
    """

    OWN = auto()
    LATE = auto()
    SECOND = auto()


@dataclass(frozen=True)
class Expected:
    """An acknowledgement that may arrive until `until_ms`; `owner` is the command that the write was for."""

    kind: AnsweredWrite
    owner: CommandId | None
    until_ms: int


class Acks:
    """Keys that rest, and the acknowledgements of each that no run waits for, in the order of their writes.

    Writes before those of a waiting command (`_earlier`) are answered before it, the client's own (`_own`) after it.
    """

    def __init__(self) -> None:
        self._rests_until_ms: dict[AckKey, int] = {}
        self._earlier: defaultdict[AckKey, list[Expected]] = defaultdict(list)
        self._own: defaultdict[AckKey, list[Expected]] = defaultdict(list)

    def is_free(self, key: AckKey, now_ms: int) -> bool:
        return now_ms >= self._rests_until_ms.get(key, 0)

    def is_late(self, key: AckKey, now_ms: int) -> bool:
        """Whether the next acknowledgement is for an earlier write: they arrive in the order of the writes."""
        return not self.is_free(key, now_ms) and any(now_ms < one.until_ms for one in self._earlier.get(key, ()))

    def begin(self, key: AckKey) -> None:
        """A command is about to be sent under a free key, so the next acknowledgement is its own."""
        self._earlier.pop(key, None)
        self._own.pop(key, None)

    def rest(self, key: AckKey, owner: CommandId, late: int, now_ms: int) -> None:
        """Rest a key until `late` more acknowledgements have arrived, or for three seconds."""
        if self.is_free(key, now_ms):
            self._earlier[key].clear()
        self._rests_until_ms[key] = until_ms = now_ms + STRAY_ACK_MS
        self._earlier[key].extend([Expected(AnsweredWrite.LATE, owner, until_ms)] * late)

    def expect(self, key: AckKey, now_ms: int, owner: CommandId | None = None) -> None:
        """The client wrote a message of its own, for `owner` or no command; no run waits for its answer."""
        self._rests_until_ms[key] = until_ms = now_ms + STRAY_ACK_MS
        awaited = [one for one in self._own[key] if now_ms < one.until_ms]
        self._own[key] = [*awaited, Expected(AnsweredWrite.OWN, owner, until_ms)]

    def expect_second(self, key: AckKey, owner: CommandId | None, now_ms: int) -> None:
        """An accepted write may be acknowledged once more, before all later writes."""
        until_ms = now_ms + SECOND_ACK_MS
        self._rests_until_ms[key] = max(self._rests_until_ms.get(key, 0), until_ms)
        self._earlier[key].insert(0, Expected(AnsweredWrite.SECOND, owner, until_ms))

    def take(self, key: AckKey, now_ms: int) -> Expected | None:
        """Match an acknowledgement that no run waits for; None if unexpected. The last one frees its key."""
        earlier, own = self._earlier.get(key, []), self._own.get(key, [])
        expected = [*earlier, *own]
        if not expected:
            return None
        taken = next((one for one in expected if now_ms < one.until_ms), expected[0])
        (own if taken.kind is AnsweredWrite.OWN else earlier).remove(taken)
        if not any(now_ms < one.until_ms for one in (*earlier, *own)):
            self._rests_until_ms.pop(key, None)
        return taken
