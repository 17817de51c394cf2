"""What an autopilot's acknowledgement says of a command, and whether it is an answer to us."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..dialect.vehicle import OWN_COMPONENT
from ..messages import Word

_RESULTS = {
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: (Word.DENIED, "temporarily_rejected"),
    mavlink.MAV_RESULT_DENIED: (Word.DENIED, "autopilot"),
    mavlink.MAV_RESULT_UNSUPPORTED: (Word.UNSUPPORTED, None),
    mavlink.MAV_RESULT_FAILED: (Word.FAILED, "autopilot"),
    6: (Word.FAILED, "cancelled"),  # MAV_RESULT_CANCELLED
}


def refusal(result: int) -> tuple[Word, str | None]:
    """The last word for a MAV_RESULT other than accepted and in progress."""
    return _RESULTS.get(result, (Word.FAILED, f"mav_result_{result}"))


def percent_of(message: Any) -> int | None:
    """How far a command in progress is; 255 is unknown."""
    return int(message.progress) if message.progress <= 100 else None


def is_for_us(message: Any, system_id: int) -> bool:
    """Whether our system says it, to us: others are acknowledged on the same link. 0 names nobody."""
    if message.get_srcSystem() != system_id:
        return False
    return message.target_system in (0, system_id) and message.target_component in (0, OWN_COMPONENT)
