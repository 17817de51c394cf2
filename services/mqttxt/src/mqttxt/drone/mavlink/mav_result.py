"""The outcome in an autopilot's acknowledgement, and the component that it answers."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.messages import Word
from .sources import COMMANDING, Source

_NAMES = {
    number: entry.name.removeprefix("MAV_RESULT_").lower()
    for number, entry in mavlink.enums["MAV_RESULT"].items()
    if not entry.name.endswith("_ENUM_END")
} | {
    6: "cancelled",
    9: "command_unsupported_mav_frame",
    10: "not_in_control_of_autopilot",  # MAV_RESULT_NOT_IN_CONTROL; `not_in_control` is a reason of R6.6
}
"""Every MAV_RESULT; pymavlink's table lacks the last ones."""

_RESULTS = {
    mavlink.MAV_RESULT_DENIED: (Word.DENIED, "autopilot"),
    mavlink.MAV_RESULT_UNSUPPORTED: (Word.UNSUPPORTED, None),
    mavlink.MAV_RESULT_FAILED: (Word.FAILED, "autopilot"),
    6: (Word.FAILED, _NAMES[6]),
}


def refusal(result: int) -> tuple[Word, str | None]:
    """The last word for a MAV_RESULT other than accepted and in progress; `failed`, no definite no, if unknown."""
    if result in _RESULTS:
        return _RESULTS[result]
    return (Word.DENIED, _NAMES[result]) if result in _NAMES else (Word.FAILED, f"mav_result_{result}")


def percent_of(message: Any) -> int | None:
    """A command's progress in percent; None if unknown (255)."""
    return int(message.progress) if message.progress <= 100 else None


def answered(message: Any, system_id: int) -> tuple[Source, ...]:
    """The UAV client's sources that a COMMAND_ACK may answer: others share the link. A target of 0 names none."""
    if message.get_srcSystem() != system_id or message.target_system not in (0, system_id):
        return ()
    return tuple(source for source in COMMANDING if message.target_component in (0, source.component))
