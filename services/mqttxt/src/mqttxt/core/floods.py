"""Limits on the work that one client with valid credentials may cause (docs/protocol.md, section 15)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)

STATION_PER_S, STATION_AT_ONCE = 400, 1000
"""One station's messages: enough for a command to each of 250 drones at once, and a grant for each per second."""
PAUSE_MS = 1000
MOST_KNOWN = 1000
MOST_READINGS = 100
"""Most kinds of readings that are shown of one drone."""


class TokenBucket:
    """A token bucket for each station: it holds `at_once` messages, and gains `per_s` per second."""

    def __init__(self, per_s: int, at_once: int) -> None:
        self._ms = 1000 / per_s
        self._ahead_ms = at_once * self._ms
        self._paid_until_ms: dict[Hashable, float] = {}

    def takes(self, station: Hashable, now_ms: int) -> bool:
        """Whether to process one more message of a station; if so, charges it."""
        paid_until_ms = max(self._paid_until_ms.get(station, 0.0), now_ms) + self._ms
        if paid_until_ms > now_ms + self._ahead_ms:
            return False
        if len(self._paid_until_ms) >= MOST_KNOWN:
            self._paid_until_ms = {one: until for one, until in self._paid_until_ms.items() if until > now_ms}
        self._paid_until_ms[station] = paid_until_ms
        return True

    def owes(self, station: Hashable, now_ms: int, messages: int) -> None:
        """Charge a station for messages processed without `takes`; as many later ones are refused."""
        self._paid_until_ms[station] = max(self._paid_until_ms.get(station, 0.0), now_ms) + messages * self._ms


class FirstReadings:
    """The first `MOST_READINGS` kinds of readings of each drone: who stores what is shown keeps each for good."""

    def __init__(self) -> None:
        self._shown: defaultdict[Hashable, set[Hashable]] = defaultdict(set)

    def takes(self, drone: Hashable, kind: Hashable) -> bool:
        """Whether a reading's kind is among the first ones of its drone."""
        shown = self._shown[drone]
        if len(shown) < MOST_READINGS:
            shown.add(kind)
        return kind in shown


class Repetitions(Generic[Key]):
    """Limits answers to repetitions: one at once, then at most one per `PAUSE_MS`, for the last one when that is over.

    `key` identifies the repeated message: a command's id, for example.
    """

    def __init__(self) -> None:
        self._answered_ms: dict[Key, int] = {}
        self._owed: dict[Key, None] = {}

    def may_answer(self, key: Key, now_ms: int) -> bool:
        """Whether to answer now; if not, `due` returns the key later."""
        if now_ms - self._answered_ms.get(key, now_ms - PAUSE_MS) < PAUSE_MS:
            self._owed[key] = None
            return False
        self._answered_ms[key] = now_ms
        return True

    def due(self, now_ms: int) -> list[Key]:
        """The keys whose postponed answers are to be given now."""
        if not self._answered_ms:
            return []
        over = [key for key, at_ms in self._answered_ms.items() if now_ms - at_ms >= PAUSE_MS]
        for key in over:
            del self._answered_ms[key]
        found = [key for key in over if key in self._owed]
        for key in found:
            del self._owed[key]
            self._answered_ms[key] = now_ms
        return found
