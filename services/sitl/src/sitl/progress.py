"""Slow commands, as set by the side channel: MAV_RESULT_IN_PROGRESS in steps, then the answer."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from .answers import IN_PROGRESS, acknowledgement
from .outputs import Output, Reply


@dataclass
class Underway:
    """A command in progress, with its remaining steps."""

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
        """Take `{"command": N, "percents": [...], "interval_s": s}`; an empty list of percents ends it."""
        self.command, self.percents = wanted["command"], list(wanted["percents"])
        self.interval_s = wanted.get("interval_s", self.interval_s)

    def take(self, message: Any, now_s: float) -> list[Output] | None:
        """Answer with the first step, a repetition with the current one. None: answered at once, as any other."""
        if message.command != self.command or not self.percents:
            return None
        if self.underway is None:
            first, *left = self.percents
            self.underway = Underway(message, left, now_s + self.interval_s, first)
        return [self._step(self.underway)]

    def due(self, now_s: float) -> tuple[list[Output], Underway | None]:
        """The answer of a step that is due, or the command to carry out because its steps are over."""
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
    """Whether a value of the side channel is valid for `Progress.set`."""
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
