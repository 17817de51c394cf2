"""Which MAV_CMD may be sent now: an acknowledgement names only the number and whom it answers, so a late one must find
nobody waiting.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum, auto

from ..dialect.sources import Source

STRAY_ACK_MS = 3000
"""How long a key rests while acknowledgements of it may still be under way."""

AckKey = tuple[int, Source]
"""What an acknowledgement is told by: the MAV_CMD, and in whose name it was sent."""


class Stray(Enum):
    """What an acknowledgement that found nobody waiting was for: something of ours, a command given up, nothing."""

    OWN = auto()
    LATE = auto()
    UNKNOWN = auto()


class Acks:
    """Keys that rest, and how many acknowledgements of each nobody waits for any more."""

    def __init__(self) -> None:
        self._rests_until_ms: dict[AckKey, int] = {}
        self._late: Counter[AckKey] = Counter()
        self._own: Counter[AckKey] = Counter()

    def is_free(self, key: AckKey, now_ms: int) -> bool:
        return now_ms >= self._rests_until_ms.get(key, 0)

    def is_late(self, key: AckKey, now_ms: int) -> bool:
        """Whether the next acknowledgement is for a command given up: they come in the order of the writes."""
        return self._late[key] > 0 and not self.is_free(key, now_ms)

    def begin(self, key: AckKey) -> None:
        """A command of a free key is about to be sent: the next acknowledgement is its own."""
        self._late.pop(key, None)
        self._own.pop(key, None)

    def rest(self, key: AckKey, late: int, now_ms: int) -> None:
        """Leave a key alone until `late` more acknowledgements have come, or for three seconds."""
        self._late[key] = late + (0 if self.is_free(key, now_ms) else self._late[key])
        self._rests_until_ms[key] = now_ms + STRAY_ACK_MS

    def expect(self, key: AckKey, now_ms: int) -> None:
        """Something of our own was written whose acknowledgement nobody waits for."""
        self._rests_until_ms[key] = now_ms + STRAY_ACK_MS
        self._own[key] += 1

    def take_stray(self, key: AckKey) -> Stray:
        """An acknowledgement found nobody waiting. The last one that was expected frees its key."""
        for kind, counts in ((Stray.OWN, self._own), (Stray.LATE, self._late)):
            if counts[key] > 0:
                counts[key] -= 1
                if not self._own[key] and not self._late[key]:
                    self._rests_until_ms.pop(key, None)
                return kind
        return Stray.UNKNOWN
