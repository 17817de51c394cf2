"""An `accepted` that waits for the word behind it (docs/protocol.md, R10.7)."""

from __future__ import annotations

from ..protocol.messages import CommandId, ResultMessage, Word

WAIT_MS = 50
"""How long at most: as words at the activator wait (R10.6), for a heartbeat that follows right behind the ACCEPTED."""


class FirstWords:
    """The commands whose `accepted` waits, in its order, and when they leave; none wait unless `is_on`."""

    def __init__(self, is_on: bool) -> None:
        self._is_on = is_on
        self._due_ms: dict[CommandId, int] = {}

    @property
    def due_ms(self) -> int | None:
        """When the first of them leaves."""
        return next(iter(self._due_ms.values()), None)

    def is_due(self, now_ms: int) -> bool:
        return self.due_ms is not None and now_ms >= self.due_ms

    def waits(self, word: ResultMessage, now_ms: int) -> bool:
        """Whether a word that is said now waits; one that tells of a late write does not."""
        if not self._is_on or word.word is not Word.ACCEPTED or word.late_ms is not None:
            return False
        self._due_ms[word.id] = now_ms + WAIT_MS
        return True

    def take(self, besides: CommandId | None = None) -> list[CommandId]:
        """All that wait, which do so no longer; `besides` is a command of which something is said by itself."""
        waiting, self._due_ms = [each for each in self._due_ms if each != besides], {}
        return waiting
