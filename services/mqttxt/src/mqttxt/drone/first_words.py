"""First words of commands that wait for the bundle of states (docs/protocol.md, R10.7)."""

from __future__ import annotations

from ..protocol.messages import CommandId, ResultMessage


class FirstWords:
    """The commands whose first words wait, oldest first. With `wait_ms` None no word waits."""

    def __init__(self, wait_ms: int | None) -> None:
        self.wait_ms = wait_ms
        self._due_ms: dict[CommandId, int] = {}

    def is_due(self, now_ms: int) -> bool:
        """Whether the oldest of them has waited for `wait_ms`."""
        return bool(self._due_ms) and now_ms >= next(iter(self._due_ms.values()))

    def waits(self, word: ResultMessage, now_ms: int) -> bool:
        """Whether a new word waits, and note that it does. Last words and those with `late_ms` do not."""
        if self.wait_ms is None or word.word.is_last or word.late_ms is not None:
            return False
        self._due_ms.setdefault(word.id, now_ms + self.wait_ms)
        return True

    def take(self, besides: CommandId | None = None) -> list[CommandId]:
        """Remove and return all waiting commands except `besides`, whose newer word is published instead."""
        waiting, self._due_ms = [each for each in self._due_ms if each != besides], {}
        return waiting
