"""Which MAV_CMD may be sent now: an acknowledgement names only the number, so a late one must find nobody waiting."""

from __future__ import annotations

from collections import Counter
from enum import Enum, auto

STRAY_ACK_MS = 3000
"""How long a number rests while acknowledgements of it may still be under way."""


class Stray(Enum):
    """What an acknowledgement that found nobody waiting was for: something of ours, a command given up, nothing."""

    OWN = auto()
    LATE = auto()
    UNKNOWN = auto()


class Acks:
    """Numbers that rest, and how many acknowledgements of each nobody waits for any more."""

    def __init__(self) -> None:
        self._rests_until_ms: dict[int, int] = {}
        self._late: Counter[int] = Counter()
        self._own: Counter[int] = Counter()

    def is_free(self, mav_cmd: int, now_ms: int) -> bool:
        return now_ms >= self._rests_until_ms.get(mav_cmd, 0)

    def begin(self, mav_cmd: int) -> None:
        """A command of a free number is about to be sent: the next acknowledgement is its own."""
        self._late.pop(mav_cmd, None)
        self._own.pop(mav_cmd, None)

    def rest(self, mav_cmd: int, late: int, now_ms: int) -> None:
        """Leave a number alone until `late` acknowledgements have come, or for three seconds."""
        self._rests_until_ms[mav_cmd] = now_ms + STRAY_ACK_MS
        self._late[mav_cmd] = late

    def expect(self, mav_cmd: int, now_ms: int) -> None:
        """Something of our own was written whose acknowledgement nobody waits for."""
        self._rests_until_ms[mav_cmd] = now_ms + STRAY_ACK_MS
        self._own[mav_cmd] += 1

    def take_stray(self, mav_cmd: int) -> Stray:
        """An acknowledgement found nobody waiting. The last one that was expected frees its number."""
        for kind, counts in ((Stray.OWN, self._own), (Stray.LATE, self._late)):
            if counts[mav_cmd] > 0:
                counts[mav_cmd] -= 1
                if not self._own[mav_cmd] and not self._late[mav_cmd]:
                    self._rests_until_ms.pop(mav_cmd, None)
                return kind
        return Stray.UNKNOWN
