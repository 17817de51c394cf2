"""The autopilot's texts for people (STATUSTEXT), assembled and published (docs/protocol.md, R3.12)."""

from __future__ import annotations

from collections import deque
from typing import Any

from ..protocol.states import AutopilotText, Severity

GAP_MS = 200
"""The least time between two texts: two with the same stamp would be taken for one."""
MOST_WAITING = 20
REST_MS = 1000
"""How long to wait for the next part of a text."""
AGAIN_MS = 10_000
"""How long repetitions of a text are dropped."""
LONGEST = 200
PART = 50
"""Characters in one STATUSTEXT."""


class Texts:
    """The texts of one autopilot that wait to be published. A full queue drops the least severe one."""

    def __init__(self) -> None:
        self._waiting: deque[AutopilotText] = deque()
        self._told_ms: dict[AutopilotText, int] = {}
        self._parts: dict[int, str] = {}
        self._id = 0
        self._severity = Severity.INFO
        self._part_ms = 0
        self._next_ms = 0

    def on_message(self, message: Any, now_ms: int) -> None:
        """A STATUSTEXT. One with an `id` is a part of a longer text, whose last part is the first that is not full."""
        if message.severity not in list(Severity):
            return
        if message.id != self._id or message.id == 0:
            self._close(now_ms)
        self._id, self._severity, self._part_ms = message.id, Severity(message.severity), now_ms
        self._parts[message.chunk_seq] = message.text
        if message.id == 0 or len(message.text) < PART:
            self._close(now_ms)

    def due(self, now_ms: int) -> list[AutopilotText]:
        """The text to publish now, if any."""
        if self._parts and now_ms - self._part_ms >= REST_MS:
            self._close(now_ms)
        if not self._waiting or now_ms < self._next_ms:
            return []
        self._next_ms = now_ms + GAP_MS
        return [self._waiting.popleft()]

    def _close(self, now_ms: int) -> None:
        """Queue the text from the received parts, unless it is a repetition."""
        said = "".join(self._parts[number] for number in sorted(self._parts))
        self._parts.clear()
        text = AutopilotText(self._severity, "".join(c for c in said if c.isprintable())[:LONGEST])
        self._told_ms = {told: at_ms for told, at_ms in self._told_ms.items() if now_ms - at_ms < AGAIN_MS}
        if not text.text or text in self._told_ms:
            return
        self._told_ms[text] = now_ms
        self._waiting.append(text)
        if len(self._waiting) > MOST_WAITING:
            self._waiting.remove(max(self._waiting, key=lambda waiting: waiting.severity))
