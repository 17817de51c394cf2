"""How PX4 speaks the log protocol: armed too; it gives bytes of a log once it was asked for the list."""

from __future__ import annotations

from typing import Any

from ..logs import LogLink


class Px4LogLink(LogLink):
    """A request takes the place of the one before."""

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
        elif kind == "LOG_REQUEST_END":
            self._has_listed = False
        elif kind == "LOG_ERASE":
            self._logs.kept.clear()
