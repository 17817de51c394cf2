"""What an autopilot gives back: messages to send and events to write down."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Happened:
    """Something for the events file."""

    event: str
    detail: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Reply:
    """A MAVLink message to send, at once and outside the streams."""

    message: Any


Output = Happened | Reply
