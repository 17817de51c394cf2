"""An autopilot's texts for people, put together from the parts of its STATUSTEXTs."""

from __future__ import annotations

from typing import Any

FULL = 50
"""Characters in one STATUSTEXT."""
LONGEST = 200


class StatusTexts:
    """Puts texts together. A message with an `id` is a part of one, whose last part is the first that is not full."""

    def __init__(self) -> None:
        self._parts: dict[int, str] = {}
        self._id = self._severity = 0

    def take(self, message: Any) -> list[tuple[int, str]]:
        """The severity and the printable characters of each text that ends with this message or before it."""
        out = [] if message.id == self._id and message.id else self.end()
        self._id, self._severity = message.id, message.severity
        self._parts[message.chunk_seq] = message.text
        return out if message.id and len(message.text) >= FULL else [*out, *self.end()]

    def end(self) -> list[tuple[int, str]]:
        """The text of which no more parts are waited for, if any."""
        said = "".join(self._parts[number] for number in sorted(self._parts))
        self._parts.clear()
        text = "".join(c for c in said if c.isprintable())[:LONGEST]
        return [(self._severity, text)] if text else []
