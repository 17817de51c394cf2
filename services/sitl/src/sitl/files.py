"""The files that an autopilot writes: its events, a line each, and one that is touched while it is ready."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TextIO

from .errors import SitlError


def open_events(path: Path) -> TextIO:
    """Open the events file for appending. Raises SitlError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("a", encoding="utf-8")
    except OSError as error:
        raise SitlError(f"--events {path}: {error.strerror}") from error


def write_event(events: TextIO, t_ns: int, event: str, **detail: Any) -> None:
    """Write one JSON object as a line; `t_ns` is since 1970."""
    events.write(json.dumps({"t_ns": t_ns, "event": event, **detail}, default=str) + "\n")
    events.flush()


def touch(path: Path) -> None:
    """Touch the ready file. Raises SitlError."""
    try:
        path.touch()
    except OSError as error:
        raise SitlError(f"--ready-file {path}: {error.strerror}") from error
