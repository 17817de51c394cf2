"""What an attempt said end to end, for either protocol: commands, states, delays, frames for each call."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import Any

from .window import Window


@dataclass(frozen=True)
class Exchange:
    """Losses are shares of what was sent in the window, None where nothing was; delays in ms by command.

    `frames_per_call` is the mean number of frames that left the ground station for a call, repetitions included.
    """

    commands_sent: int = 0
    commands_lost: float | None = None
    states_sent: int = 0
    states_lost: float | None = None
    delay_ms: dict[str, list[float]] = field(default_factory=dict)
    frames_per_call: dict[str, float] = field(default_factory=dict)


def calls_in(events: list[dict[str, Any]], window: Window) -> list[dict[str, Any]]:
    """The API calls of the mission in the order of time."""
    calls = [e for e in events if e["event"] == "command" and window.asked_ns <= e["t_ns"] <= window.end_ns]
    return sorted(calls, key=lambda call: int(call["t_ns"]))


def mean_frames(calls: list[dict[str, Any]], frames: Counter[str]) -> dict[str, float]:
    """Frames for each call, by command; a call for which no frame left counts too."""
    asked = Counter(str(call["command"]) for call in calls)
    return {command: round(frames[command] / count, 3) for command, count in asked.items()}


def delays_ms(pairs: list[tuple[str, int, int]]) -> dict[str, list[float]]:
    """One way, by capture: (command, sent, received), both in nanoseconds, to milliseconds by command."""
    found: dict[str, list[float]] = defaultdict(list)
    for command, sent_ns, received_ns in pairs:
        found[command].append(round((received_ns - sent_ns) / 1e6, 3))
    return dict(found)
