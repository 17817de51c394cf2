"""An autopilot's outputs: messages to send and events to record."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Happened:
    """An event for the events file."""

    event: str
    detail: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Reply:
    """A MAVLink message to send, at once and outside the streams."""

    message: Any


Output = Happened | Reply
