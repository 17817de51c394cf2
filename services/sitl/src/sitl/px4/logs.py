"""PX4's side of the log protocol: it answers while armed, too, and sends bytes only after a request for the list.

PX4 main fills its last message beyond the requested bytes, and sends nothing past a log's end.
"""

from __future__ import annotations

from typing import Any

from ..logs import DATA_BYTES, LogLink


class Px4LogLink(LogLink):
    """PX4's log protocol on one link: a request replaces the one before."""

    first = 0
    _has_listed = False

    def answer(self, message: Any) -> None:
        kind = message.get_type()
        self._sent = None
        if kind == "LOG_REQUEST_LIST":
            self._has_listed = True
            self._list(message)
        elif kind == "LOG_REQUEST_DATA" and self._has_listed:
            self._begin(message)
        elif kind == "LOG_ERASE":
            self._logs.kept.clear()

    def _begin(self, message: Any) -> None:
        super()._begin(message)
        if self._sent is not None:
            asked = -(-message.count // DATA_BYTES) * DATA_BYTES
            self._end = min(len(self._sent.data), message.ofs + asked)
            self._sent = self._sent if message.ofs < len(self._sent.data) else None
