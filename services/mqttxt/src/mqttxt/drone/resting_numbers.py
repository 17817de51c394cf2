"""Which MAV_CMD may be sent now: an acknowledgement names only the number and whom it answers, so a late one must find
nobody waiting.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from enum import Enum, auto

from ..protocol.messages import CommandId
from .mavlink.sources import Source

STRAY_ACK_MS = 3000
"""How long a key rests while acknowledgements of it may still be under way."""
SECOND_ACK_MS = 300
"""How long a key rests for a second acknowledgement; PX4 writes both at once. Less than the time between copies."""

AckKey = tuple[int, Source]
"""What identifies an acknowledgement: the MAV_CMD, and in whose name it was sent."""


class Kind(Enum):
    """What an acknowledgement is of, if nobody waits for it: something of our own, another copy of a command that
    was answered or given up, or what was accepted before.
    """

    OWN = auto()
    LATE = auto()
    SECOND = auto()


@dataclass(frozen=True)
class Expected:
    """An acknowledgement that may come until `until_ms`, and the command on whose behalf the write was."""

    kind: Kind
    owner: CommandId | None
    until_ms: int


class Acks:
    """Keys that rest, and the acknowledgements of each that nobody waits for, in the order of their writes.

    What was written before a command that waits (`_earlier`) is answered before it, our own writes after it.
    """

    def __init__(self) -> None:
        self._rests_until_ms: dict[AckKey, int] = {}
        self._earlier: defaultdict[AckKey, list[Expected]] = defaultdict(list)
        self._own: defaultdict[AckKey, list[Expected]] = defaultdict(list)

    def is_free(self, key: AckKey, now_ms: int) -> bool:
        return now_ms >= self._rests_until_ms.get(key, 0)

    def is_late(self, key: AckKey, now_ms: int) -> bool:
        """Whether the next acknowledgement is for an earlier write: they come in the order of the writes."""
        return not self.is_free(key, now_ms) and any(now_ms < one.until_ms for one in self._earlier.get(key, ()))

    def begin(self, key: AckKey) -> None:
        """A command of a free key is about to be sent: the next acknowledgement is its own."""
        self._earlier.pop(key, None)
        self._own.pop(key, None)

    def rest(self, key: AckKey, owner: CommandId, late: int, now_ms: int) -> None:
        """Leave a key alone until `late` more acknowledgements have come, or for three seconds."""
        if self.is_free(key, now_ms):
            self._earlier[key].clear()
        self._rests_until_ms[key] = until_ms = now_ms + STRAY_ACK_MS
        self._earlier[key].extend([Expected(Kind.LATE, owner, until_ms)] * late)

    def expect(self, key: AckKey, now_ms: int, owner: CommandId | None = None) -> None:
        """Something of our own was written, on behalf of a command or of none, and no run waits for its answer."""
        self._rests_until_ms[key] = until_ms = now_ms + STRAY_ACK_MS
        self._own[key].append(Expected(Kind.OWN, owner, until_ms))

    def expect_second(self, key: AckKey, owner: CommandId | None, now_ms: int) -> None:
        """A write was accepted that may be acknowledged once more, before all that was written after it."""
        until_ms = now_ms + SECOND_ACK_MS
        self._rests_until_ms[key] = max(self._rests_until_ms.get(key, 0), until_ms)
        self._earlier[key].insert(0, Expected(Kind.SECOND, owner, until_ms))

    def take(self, key: AckKey, now_ms: int) -> Expected | None:
        """No run waits for this acknowledgement. The last one that was expected frees its key."""
        earlier, own = self._earlier.get(key, []), self._own.get(key, [])
        expected = [*earlier, *own]
        if not expected:
            return None
        taken = next((one for one in expected if now_ms < one.until_ms), expected[0])
        (own if taken.kind is Kind.OWN else earlier).remove(taken)
        if not any(now_ms < one.until_ms for one in (*earlier, *own)):
            self._rests_until_ms.pop(key, None)
        return taken
