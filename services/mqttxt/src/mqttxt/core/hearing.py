"""Whether a connection still delivers: a broker may answer PINGREQ and have lost the subscriptions (R9.17)."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import replace

from .clock import BEACON_INTERVAL_MS
from .effects import Effect, Publish, Reconnect

SILENT_MS = BEACON_INTERVAL_MS + 2_000
"""Silence before a test: each node receives at least one message of its counterpart per beacon interval."""
LONGEST_SILENT_MS = 8 * SILENT_MS
"""The same after several useless reconnects: the broker may forbid this node to receive its own messages."""
ANSWER_MS = 5_000
"""A test message returns within this time of the broker's acknowledgement."""
UNANSWERED_MS = 30_000
"""The wait without an acknowledgement: until then the keep-alive has ended a connection that carries nothing at all."""
STALL_MS = 1_000
"""A process that was not called for this long stood still, and messages of that time may wait to be read."""
ASKED = "hearing"
"""The `ref` of test messages."""
_FIRST_FAILURE = 0x80
"""The lowest failure among MQTT 5's reason codes."""


class Hearing:
    """Tests whether the connection `link` still delivers, after a silence.

    `say` publishes the test message: one that its owner itself subscribes to, such as its birth. A broker that does
    not answer at all is left to the keep-alive, because the will of a connection that is given up may cost control.
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
        """The connection is up, and its subscriptions are requested."""
        self._is_granted = False
        self._ask(now_ms)

    def granted(self, now_ms: int) -> None:
        """All subscriptions are granted."""
        self._is_granted = True
        self._listen(now_ms)

    def heard(self, now_ms: int) -> None:
        """A message has arrived."""
        if self._is_granted:
            self._silent_ms = SILENT_MS
            self._listen(now_ms)

    def published(self, ref: Hashable, code: int, now_ms: int) -> bool:
        """A publish with `ref` was acknowledged; returns whether it was a test message."""
        if ref != ASKED:
            return False
        if self._is_granted and self._has_asked and not self._is_taken:
            if code < _FIRST_FAILURE:
                self._is_taken, self._due_ms = True, now_ms + ANSWER_MS
            else:
                self._listen(now_ms)
        return True

    def end(self) -> None:
        """Stop testing: the connection has ended, or is to be left alone."""
        self._due_ms, self._is_granted = None, False

    def tick(self, now_ms: int) -> list[Effect]:
        """Publish a test message after a silence, or reconnect if that message has not returned."""
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
