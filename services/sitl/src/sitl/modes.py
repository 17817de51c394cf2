"""PX4's flight modes, and what an autopilot gives back: messages to send and events to write down."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any


class Mode(Enum):
    """PX4's modes as (main, sub) of custom_mode."""

    MANUAL = (1, 0)
    ALTITUDE = (2, 0)
    POSITION = (3, 0)
    TAKEOFF = (4, 2)
    HOLD = (4, 3)
    MISSION = (4, 4)
    RETURN = (4, 5)
    LAND = (4, 6)
    ACRO = (5, 0)
    OFFBOARD = (6, 0)
    STABILIZED = (7, 0)

    @property
    def custom_mode(self) -> int:
        """main << 16 | sub << 24, as HEARTBEAT carries it."""
        return self.value[0] << 16 | self.value[1] << 24

    @property
    def is_auto(self) -> bool:
        """Whether the autopilot flies by itself in it."""
        return self.custom_mode >> 16 & 0xFF == 4


NEEDS_STICKS = frozenset({Mode.MANUAL, Mode.ALTITUDE, Mode.POSITION, Mode.ACRO, Mode.STABILIZED})
"""Modes for a pilot's hands, which the stand-in has none of."""


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
