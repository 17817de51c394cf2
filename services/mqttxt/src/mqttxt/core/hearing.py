"""Whether a connection still delivers: a broker may answer PINGREQ and have lost the subscriptions (R9.17)."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import replace

from .clock import BEACON_INTERVAL_MS
from .effects import Effect, Publish, Reconnect

SILENT_MS = BEACON_INTERVAL_MS + 2_000
"""Each node hears something of its counterpart in an interval of beacons."""
LONGEST_SILENT_MS = 8 * SILENT_MS
"""Where a new connection delivered nothing either: this node may not be allowed to hear what it says."""
ANSWER_MS = 5_000
"""What the broker has acknowledged comes back within that."""
UNANSWERED_MS = 30_000
"""Without an acknowledgement: by then the keep-alive has ended a connection over which nothing comes at all."""
STALL_MS = 1_000
"""A process that was not called for so long stood still, and what has come meanwhile waits to be read."""
ASKED = "hearing"
"""The `ref` of what is said to be heard."""
_FIRST_FAILURE = 0x80
"""Of MQTT 5's reason codes."""


class Hearing:
    """Finds out whether the connection `link` delivers, where nothing comes over it.

    `say` publishes something that its owner subscribes to, and so hears, whoever else is there: its birth. A broker
    that stands still is the keep-alive's to judge: the will of a connection that is given up may cost control.
    """

    def __init__(self, link: str, say: Callable[[], Iterable[Effect]]) -> None:
        self._link = link
        self._say = say
        self._silent_ms = SILENT_MS
        self._due_ms: int | None = None
        self._is_granted = False
        self._has_asked = self._is_taken = self._stood_still = self._was_put_off = False
        self._called_ms = 0

    def connected(self, now_ms: int) -> None:
        """Subscriptions are asked for."""
        self._is_granted = False
        self._ask(now_ms)

    def granted(self, now_ms: int) -> None:
        """All of them are granted."""
        self._is_granted = True
        self._listen(now_ms)

    def heard(self, now_ms: int) -> None:
        """A message has come."""
        if self._is_granted:
            self._silent_ms = SILENT_MS
            self._listen(now_ms)

    def published(self, ref: Hashable, code: int, now_ms: int) -> bool:
        """A publish with `ref` was acknowledged; returns whether it was what was said to be heard."""
        if ref != ASKED:
            return False
        if self._is_granted and self._has_asked and not self._is_taken:
            if code < _FIRST_FAILURE:
                self._is_taken, self._due_ms = True, now_ms + ANSWER_MS
            else:
                self._listen(now_ms)
        return True

    def end(self) -> None:
        """The connection has ended, or is to be left alone."""
        self._due_ms, self._is_granted = None, False

    def tick(self, now_ms: int) -> list[Effect]:
        """What is to be said into a silence, and, where that is not heard either, that the connection is of no use."""
        pause_ms, self._called_ms = now_ms - self._called_ms, now_ms
        self._stood_still = self._stood_still or (self._has_asked and pause_ms > STALL_MS)
        if self._due_ms is None or now_ms < self._due_ms:
            return []
        if not self._has_asked:
            self._ask(now_ms)
            return [replace(said, ref=ASKED) if isinstance(said, Publish) else said for said in self._say()]
        if self._stood_still and not self._was_put_off:
            self._was_put_off, self._due_ms = True, now_ms + ANSWER_MS
            return []
        self.end()
        self._silent_ms = min(2 * self._silent_ms, LONGEST_SILENT_MS)
        return [Reconnect(self._link, "it delivers nothing, not even what this node says itself")]

    def _listen(self, now_ms: int) -> None:
        self._due_ms, self._has_asked = now_ms + self._silent_ms, False

    def _ask(self, now_ms: int) -> None:
        self._due_ms, self._has_asked = now_ms + UNANSWERED_MS, True
        self._is_taken = self._stood_still = self._was_put_off = False
