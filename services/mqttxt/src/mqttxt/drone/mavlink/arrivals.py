"""When each kind of an autopilot's messages arrived last, and how often they arrive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass
class _Arrival:
    """The arrivals of one kind of message: the number and time of the last, and the smoothed interval."""

    number: int
    at_ms: int
    interval_ms: float | None = None


class Arrivals:
    """The arrivals of one autopilot's messages, by their kind."""

    def __init__(self) -> None:
        self._of_kind: dict[str, _Arrival] = {}

    def note(self, kind: str, number: int, now_ms: int) -> None:
        """A message has arrived; `number` counts all."""
        found = self._of_kind.get(kind)
        if found is None:
            self._of_kind[kind] = _Arrival(number, now_ms)
            return
        interval_ms = now_ms - found.at_ms
        smoothed = found.interval_ms
        found.interval_ms = interval_ms if smoothed is None else 0.9 * smoothed + 0.1 * interval_ms
        found.number, found.at_ms = number, now_ms

    def number_of(self, kind: str) -> int:
        """The number of the last message of a kind, -1 if none arrived."""
        found = self._of_kind.get(kind)
        return found.number if found is not None else -1

    def silence_ms(self, kind: str, now_ms: int) -> float:
        """The time since the last message of a kind, ms; infinite without one."""
        found = self._of_kind.get(kind)
        return math.inf if found is None else now_ms - found.at_ms

    def silent(self, kinds: Mapping[str, str], since_ms: int) -> list[str]:
        """The keys of the kinds of messages of which none arrived after `since_ms`."""
        arrived = self._of_kind
        return [name for name, kind in kinds.items() if kind not in arrived or arrived[kind].at_ms <= since_ms]

    def rate_hz(self, kind: str, now_ms: int) -> float:
        """The measured rate of a kind of message, Hz; 0 before the second one, falling once they stop."""
        found = self._of_kind.get(kind)
        if found is None or found.interval_ms is None:
            return 0.0
        since_ms = now_ms - found.at_ms
        return 1000 / max(1.0, found.interval_ms, since_ms if since_ms > 3 * found.interval_ms else 0.0)
