"""How good a connection is, by the broker's answers to PINGREQ (docs/protocol.md, R19.9); no I/O."""

from __future__ import annotations

PROBE_MS = 200
"""Between two questions on the main link."""
SPARE_PROBE_MS = 2000
"""On the other one, where every byte may cost something."""
LEAST_PATIENCE_MS, MOST_PATIENCE_MS = 400, 2000
LOST_MS = 1000
"""What a loss of every answer adds to the round trip."""
STEP_MS = 100
"""Of the time between two looks no more counts as waiting: in the rest this process stood still."""


class Measure:
    """One connection since it is up: questions, one at a time, and what their answers say."""

    def __init__(self) -> None:
        self.answers = 0
        self.loss = 0.0
        self.waited_ms = 0
        """How long the question that was asked last has waited for its answer; 0 once it has come."""
        self._round_trip_ms: float | None = None
        self._asked_ms: int | None = None
        self._last_asked_ms: int | None = None
        self._is_late = False

    @property
    def patience_ms(self) -> float:
        """After which an answer is late."""
        if self._round_trip_ms is None:
            return MOST_PATIENCE_MS
        return min(MOST_PATIENCE_MS, max(LEAST_PATIENCE_MS, 2 * self._round_trip_ms))

    @property
    def is_silent(self) -> bool:
        return self._is_late

    @property
    def is_doubtful(self) -> bool:
        return self.waited_ms > self.patience_ms / 2

    @property
    def cost_ms(self) -> float | None:
        """Round trip and loss in one figure; None before the first answer."""
        return None if self._round_trip_ms is None else self._round_trip_ms + LOST_MS * self.loss

    def is_due(self, now_ms: int, interval_ms: int) -> bool:
        """Whether to ask again: never while an answer is awaited."""
        last_ms = self._last_asked_ms
        return self._asked_ms is None and (last_ms is None or now_ms - last_ms >= interval_ms)

    def on_asked(self, now_ms: int) -> None:
        self._asked_ms = self._last_asked_ms = now_ms
        self.waited_ms = 0

    def on_answer(self, now_ms: int) -> None:
        if self._asked_ms is None:
            return
        took_ms = min(now_ms - self._asked_ms, self.waited_ms + STEP_MS, self.patience_ms)
        known_ms = self._round_trip_ms
        self._round_trip_ms = took_ms if known_ms is None else known_ms + (took_ms - known_ms) / 4
        if not self._is_late:
            self.loss -= self.loss / 8
        self.answers += 1
        self._asked_ms, self._is_late, self.waited_ms = None, False, 0

    def on_time(self, passed_ms: int) -> None:
        """So much time has passed since the last look, answers taken in."""
        if self._asked_ms is None:
            return
        self.waited_ms += min(passed_ms, STEP_MS)
        if not self._is_late and self.waited_ms > self.patience_ms:
            self._is_late = True
            self.loss += (1 - self.loss) / 8
