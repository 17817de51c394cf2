"""Whether a connection still delivers: a broker may answer PINGREQ and have lost the subscriptions (R9.17)."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from .clock import BEACON_INTERVAL_MS
from .effects import Effect, Reconnect

SILENT_MS = BEACON_INTERVAL_MS + 2_000
"""Each node hears something of its counterpart in an interval of beacons."""
ANSWER_MS = 5_000
STALL_MS = 1_000
"""A process that was not called for so long stood still, and what has come meanwhile waits to be read."""


class Hearing:
    """Finds out whether the connection `link` delivers, where nothing comes over it.

    `say` publishes something that its owner subscribes to, and so hears, whoever else is there: its birth.
    """

    def __init__(self, link: str, say: Callable[[], Iterable[Effect]]) -> None:
        self._link = link
        self._say = say
        self._due_ms: int | None = None
        self._has_asked = False
        self._called_ms = 0

    def heard(self, now_ms: int) -> None:
        """A message has come, or the subscriptions are granted."""
        self._due_ms, self._has_asked = now_ms + SILENT_MS, False

    def end(self) -> None:
        """The connection has ended, or is to be left alone."""
        self._due_ms = None

    def tick(self, now_ms: int) -> list[Effect]:
        """What is to be said into a silence, and, where that is not heard either, that the connection is of no use."""
        pause_ms, self._called_ms = now_ms - self._called_ms, now_ms
        if self._due_ms is None or now_ms < self._due_ms:
            return []
        if self._has_asked and pause_ms > STALL_MS:
            self._due_ms = now_ms + ANSWER_MS
            return []
        if self._has_asked:
            self.end()
            return [Reconnect(self._link, "it delivers nothing, not even what this node says itself")]
        self._due_ms, self._has_asked = now_ms + ANSWER_MS, True
        return [*self._say()]
