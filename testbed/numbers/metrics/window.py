"""The window of a mission, in which traffic is counted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import polars as pl

from ...errors import ResultsError
from ...fly.results import Attempt
from ..packets import Packets, load
from .ways import STATION, Ways

MAV_CMD_ARM = 400
MESSAGE_SET = "messages"
"""The scenario in `mission_start` that flies ten kinds of messages, one at a time."""
SECOND_NS = 1_000_000_000
LONGEST_S = 86_400.0


@dataclass(frozen=True)
class Window:
    """From the first arm command leaving the ground station until the last drone disarms, in the message set until its
    last kind ends; nanoseconds.

    `asked_ns` is when the mission called that command.
    """

    start_ns: int
    end_ns: int
    asked_ns: int

    @property
    def seconds(self) -> float:
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def whole_seconds(self) -> int:
        """How many seconds have begun; the last one may be incomplete."""
        return max(1, -(-(self.end_ns - self.start_ns) // SECOND_NS))

    @property
    def second(self) -> pl.Expr:
        """In which of them a row of packets or messages entered its link."""
        since = (pl.col("t_ns") - self.start_ns) // SECOND_NS
        return since.clip(upper_bound=self.whole_seconds - 1).alias("second")

    def holds(self, t_ns: int) -> bool:
        """Whether a time lies in the window."""
        return self.start_ns <= t_ns <= self.end_ns

    @property
    def entered(self) -> pl.Expr:
        """Whether a row of packets or messages entered its link in the window."""
        return pl.col("t_ns").is_between(self.start_ns, self.end_ns)

    @property
    def left(self) -> pl.Expr:
        """Whether a row of packets or messages left its link in the window."""
        return pl.col("left_ns").is_between(self.start_ns, self.end_ns).fill_null(False)


def mission_window(attempt: Attempt, events: list[dict[str, Any]], packets: Packets | None = None) -> Window | None:
    """The window of an attempt's mission; None if the mission never began. A failed mission's ends when it gave up.

    `packets` is the attempt's packets table, loaded if it is not given.
    """
    asked_ns = arm_asked_ns(events)
    if asked_ns is None:
        return None
    start_ns = _first_command_ns(attempt, packets if packets is not None else load(attempt), asked_ns)
    disarmed = [
        event["t_ns"]
        for log in attempt.autopilot_events().values()
        for event in log
        if event["event"] == "disarmed" and event["t_ns"] > start_ns
    ]
    ended = [event for event in events if event["event"] == "mission_end"]
    if ended and ended[-1]["status"] == "completed":
        over = [event["t_ns"] for event in events if event["event"] == "kind_done"]
        finished = over if is_message_set(events) else disarmed
        if finished:
            return _sensible(Window(start_ns, max(finished), asked_ns), attempt)
    last_ns = max([ended[-1]["t_ns"]] if ended else [event["t_ns"] for event in events])
    return _sensible(Window(start_ns, max(last_ns, start_ns), asked_ns), attempt)


def _sensible(window: Window, attempt: Attempt) -> Window:
    """Raise ResultsError for a window that no mission has, as of a clock that was set: every second has a count."""
    if window.seconds > LONGEST_S:
        raise ResultsError(f"{attempt.path}: a mission of {window.seconds:.0f} s, expected at most {LONGEST_S:.0f} s")
    return window


def is_message_set(events: list[dict[str, Any]]) -> bool:
    """Whether the mission was the message set, in which a drone arms and disarms many times."""
    return any(event["event"] == "mission_start" and event["scenario"] == MESSAGE_SET for event in events)


def arm_asked_ns(events: list[dict[str, Any]]) -> int | None:
    """When the mission first called `arm`; None if it never began."""
    return next((int(e["t_ns"]) for e in events if e["event"] == "command" and e["command"] == "arm"), None)


def _first_command_ns(attempt: Attempt, packets: Packets, asked_ns: int) -> int:
    """When the first command after `asked_ns` left the ground station, by the station's capture; else `asked_ns`."""
    leaving = Ways(attempt.topology()).leaving(STATION)
    sent = packets.messages.filter(
        (pl.col("t_ns") >= asked_ns) & pl.col("link").cast(pl.String).is_in(leaving), is_command() | is_arm()
    )
    return int(sent["t_ns"][0]) if len(sent) else asked_ns


def is_command() -> pl.Expr:
    """Whether a message is a PUBLISH of an MQTT-XT command."""
    return pl.col("topic").str.split("/").list.last().eq("commands").fill_null(False)


def is_arm() -> pl.Expr:
    """Whether a message is MAVLink's command to arm."""
    is_long = pl.col("kind").cast(pl.String) == "COMMAND_LONG"
    return (is_long & (pl.col("command") == MAV_CMD_ARM) & (pl.col("param1") == 1)).fill_null(False)
