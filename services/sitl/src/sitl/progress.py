"""Commands that take their time: MAV_RESULT_IN_PROGRESS in steps, then the answer, as the side channel asks for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from .answers import IN_PROGRESS, acknowledgement
from .outputs import Output, Reply


@dataclass
class Underway:
    """A command that was received, and the steps of it that are still to come."""

    message: Any
    left: list[int]
    next_s: float
    percent: int


@dataclass
class Progress:
    """Which MAV_CMD is answered in steps: `percents` (255: unknown), each `interval_s` after the one before."""

    command: int = -1
    percents: list[int] = field(default_factory=list)
    interval_s: float = 0.5
    underway: Underway | None = None

    def set(self, wanted: dict[str, Any]) -> None:
        """`{"command": N, "percents": [...], "interval_s": s}`; no percents end it."""
        self.command, self.percents = wanted["command"], list(wanted["percents"])
        self.interval_s = wanted.get("interval_s", self.interval_s)

    def take(self, message: Any, now_s: float) -> list[Output] | None:
        """The first step's answer; a repetition hears where it is. None: it is answered at once as any other."""
        if message.command != self.command or not self.percents:
            return None
        if self.underway is None:
            first, *left = self.percents
            self.underway = Underway(message, left, now_s + self.interval_s, first)
        return [self._step(self.underway)]

    def due(self, now_s: float) -> tuple[list[Output], Underway | None]:
        """The step that is due, or the command whose steps are over and that is to be carried out."""
        underway = self.underway
        if underway is None or now_s < underway.next_s:
            return [], None
        underway.next_s += self.interval_s
        if not underway.left:
            self.underway = None
            return [], underway
        underway.percent = underway.left.pop(0)
        return [self._step(underway)], None

    def _step(self, underway: Underway) -> Reply:
        return Reply(acknowledgement(underway.message, IN_PROGRESS, underway.percent))


def is_progress(value: Any) -> bool:
    """Whether the side channel's value can be set."""
    if not isinstance(value, dict) or not {"command", "percents"} <= set(value) <= {
        "command",
        "percents",
        "interval_s",
    }:
        return False
    interval_s, percents = value.get("interval_s", 1), value["percents"]
    if not isinstance(interval_s, int | float) or not 0.02 <= interval_s <= 60 or type(value["command"]) is not int:
        return False
    return isinstance(percents, list) and all(type(p) is int and 0 <= p <= 255 for p in percents)
