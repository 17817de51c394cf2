"""`events.jsonl`: a line for each change of a link, with its time and its cause, as it happens."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..interfaces import NetError

PROFILE, HAND, RANGE = "profile", "hand", "range"


class Journal:
    """Writes the file. Raises NetError if it cannot be written."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("a", encoding="utf-8", buffering=1)
        except OSError as error:
            raise NetError(f"{path}: {error.strerror}; expected a file that can be written") from error

    def started(self, t_ns: int) -> None:
        """Record the start of the links' clock (unix time)."""
        self._write({"t_ns": t_ns, "event": "start"})

    def changed(self, t_ns: int, link: str, change: Mapping[str, Any] | None, cause: str) -> None:
        """Record that `change` overrides the link's steady figures from `t_ns` on; None: that cause's change ends."""
        self._write({"t_ns": t_ns, "link": link, "change": None if change is None else dict(change), "cause": cause})

    def close(self) -> None:
        self._file.close()

    def _write(self, record: Mapping[str, Any]) -> None:
        try:
            self._file.write(json.dumps(record) + "\n")
        except OSError as error:
            raise NetError(f"{self._path}: {error.strerror}; expected a file that can be written") from error


def write_json(path: Path, content: Mapping[str, Any], indent: int | None = 1) -> None:
    """Write a file completely or not at all. Raises NetError."""
    try:
        fresh = path.with_suffix(".new")
        fresh.write_text(json.dumps(content, indent=indent) + "\n")
        fresh.replace(path)
    except OSError as error:
        raise NetError(f"{path}: {error.strerror}; expected a file that can be written") from error
