"""ArduPilot's side of the log protocol: only while disarmed, and one request after the other."""

from __future__ import annotations

from typing import Any

from ..logs import LogLink


class CopterLogLink(LogLink):
    """ArduPilot's log protocol on one link: while it sends data, further requests for a list or data are ignored."""

    first = 1
    _has_warned = False

    def answer(self, message: Any) -> None:
        kind = message.get_type()
        if self._autopilot.armed:
            if not self._has_warned:
                self._autopilot.say("Disarm for log download")
            self._has_warned = True
            return
        self._has_warned = False
        if kind == "LOG_REQUEST_END":
            self._sent = None
        elif kind == "LOG_ERASE":
            self._logs.kept.clear()
        elif self._sent is None and kind == "LOG_REQUEST_LIST":
            self._list(message)
        elif self._sent is None:
            self._begin(message)

    def due(self) -> list[Any]:
        return [] if self._autopilot.armed else super().due()
