"""`events.jsonl`: what changed on which link, when, and whose doing it was; a line each, as it happens."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..interfaces import NetError

PROFILE, HAND, RANGE = "profile", "hand", "range"


class Journal:
    """Raises NetError where the file cannot be written."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("a", encoding="utf-8", buffering=1)
        except OSError as error:
            raise NetError(f"{path}: {error.strerror}; expected a file that can be written") from error

    def started(self, t_ns: int) -> None:
        """From here on the links' clock runs (unix time)."""
        self._write({"t_ns": t_ns, "event": "start"})

    def changed(self, t_ns: int, link: str, change: Mapping[str, Any] | None, cause: str) -> None:
        """`change` stands over the link's steady figures from here on; None: nothing of that cause does any more."""
        self._write({"t_ns": t_ns, "link": link, "change": None if change is None else dict(change), "cause": cause})

    def close(self) -> None:
        self._file.close()

    def _write(self, record: Mapping[str, Any]) -> None:
        try:
            self._file.write(json.dumps(record) + "\n")
        except OSError as error:
            raise NetError(f"{self._path}: {error.strerror}; expected a file that can be written") from error
