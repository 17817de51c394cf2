"""The autopilot's texts for people (STATUSTEXT), assembled and published (docs/protocol.md, R3.12)."""

from __future__ import annotations

from collections import OrderedDict, deque
from typing import Any

from ..protocol.states import AutopilotText, Severity
from .mavlink.statustext import StatusTexts

GAP_MS = 200
"""The least time between two texts: two with the same stamp would be taken for one."""
MOST_WAITING = 20
REST_MS = 1000
"""How long to wait for the next part of a text."""
AGAIN_MS = 10_000
"""How long repetitions of a text are dropped."""


class Texts:
    """The texts of one autopilot that wait to be published. A full queue drops the least severe one."""

    def __init__(self) -> None:
        self._waiting: deque[AutopilotText] = deque()
        self._told_ms: OrderedDict[AutopilotText, int] = OrderedDict()
        self._parts = StatusTexts()
        self._part_ms = 0
        self._next_ms = 0

    def on_message(self, message: Any, now_ms: int) -> None:
        """A STATUSTEXT: a text or a part of one."""
        if message.severity not in list(Severity):
            return
        self._part_ms = now_ms
        self._queue(self._parts.take(message), now_ms)

    def due(self, now_ms: int) -> list[AutopilotText]:
        """The text to publish now, if any."""
        if now_ms - self._part_ms >= REST_MS:
            self._queue(self._parts.end(), now_ms)
        if not self._waiting or now_ms < self._next_ms:
            return []
        self._next_ms = now_ms + GAP_MS
        return [self._waiting.popleft()]

    def _queue(self, texts: list[tuple[int, str]], now_ms: int) -> None:
        """Queue texts, unless they are repetitions."""
        while self._told_ms and now_ms - next(iter(self._told_ms.values())) >= AGAIN_MS:
            self._told_ms.popitem(last=False)
        for severity, said in texts:
            text = AutopilotText(Severity(severity), said)
            if text in self._told_ms:
                continue
            self._told_ms[text] = now_ms
            self._waiting.append(text)
            if len(self._waiting) > MOST_WAITING:
                self._waiting.remove(max(self._waiting, key=lambda waiting: waiting.severity))
