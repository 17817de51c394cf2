"""An attempt's messages end to end, for either protocol: when each command and each state left and arrived."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import polars as pl

from ..attempt_entry import DroneMessages, KindOfMessages
from ..packets import Packets
from ..statistics import loss_of
from .ways import STATION, Ways
from .window import Window

SENT = pl.Schema({
    "name": pl.String(), "drone": pl.Int64(), "t_ns": pl.Int64(), "arrived_ns": pl.Int64(), "frame": pl.Int64(),
})  # fmt: skip
"""A row for each message sent: the name of the command or state, the drone that it is sent to or by, when its first
frame left its origin (null: never), when its first copy reached the far end (null: never), and the row of that first
frame in the packets table."""
SAME_MESSAGE_NS = 300_000_000_000
"""A key that is seen again after a longer time belongs to another message: MQTT-XT's stamps wrap after 655 s."""


@dataclass(frozen=True)
class Exchange:
    """Commands and states of the window, with the columns of `SENT`.

    `frames_per_call` is the mean number of frames that left the ground station for a call, repetitions included.
    `left_ns` is when the ground station signed off, after which it is sent no states (None: it did not).
    """

    commands: pl.DataFrame = field(default_factory=SENT.to_frame)
    states: pl.DataFrame = field(default_factory=SENT.to_frame)
    frames_per_call: dict[str, float] = field(default_factory=dict)
    left_ns: int | None = None

    def states_until_ns(self, packets: Packets, ways: Ways) -> dict[int, int]:
        """By drone until when states could arrive: until the station's capture ended or the station signed off."""
        captured_ns = packets.until_ns[STATION]
        return dict.fromkeys(ways.drones, captured_ns if self.left_ns is None else min(captured_ns, self.left_ns))


def calls_in(events: list[dict[str, Any]], window: Window) -> list[dict[str, Any]]:
    """The mission's API calls, sorted by time."""
    calls = [e for e in events if e["event"] == "command" and window.asked_ns <= e["t_ns"] <= window.end_ns]
    return sorted(calls, key=lambda call: int(call["t_ns"]))


def mean_frames(calls: list[dict[str, Any]], frames: Counter[str]) -> dict[str, float]:
    """The mean number of frames per call, by command; a call without frames counts too."""
    asked = Counter(str(call["command"]) for call in calls)
    return {command: round(frames[command] / count, 3) for command, count in asked.items()}


def with_arrivals(sent: pl.DataFrame, arrived: pl.DataFrame, by: list[str], repeats: bool) -> pl.DataFrame:
    """Add the column `arrived_ns` to `sent`: when the first copy of each message arrived, null if none did.

    `sent` has the columns `by` and `t_ns`, `arrived` has `by` and `arrived_ns`; each copy belongs to the last message
    with its key that was sent before it. `repeats`: a key sent again within SAME_MESSAGE_NS is the same message.
    """
    sent = sent.sort("t_ns", maintain_order=True)
    if repeats:
        since = pl.col("t_ns") - pl.col("t_ns").shift(1).over(by)
        sent = sent.filter((since > SAME_MESSAGE_NS).fill_null(True))
    sent = sent.with_row_index("number")
    # one time axis for both, sent before arrived where they are equal
    asked = sent.select(*by, pl.col("t_ns").alias("at"), "number")
    copies = arrived.select(*by, pl.col("arrived_ns").alias("at")).sort("at", maintain_order=True)
    found = (
        copies.join_asof(asked, on="at", by=by, strategy="backward", check_sortedness=False)
        .filter(pl.col("number").is_not_null())
        .group_by("number", maintain_order=True)
        .agg(pl.col("at").min().alias("arrived_ns"))
    )
    return sent.join(found, on="number", how="left", maintain_order="left").drop("number")


def count_messages(sent: pl.DataFrame, until_ns: dict[int, int]) -> dict[str, KindOfMessages]:
    """Count the messages sent and lost, by name and drone.

    `until_ns` is, by drone, until when the far end could receive. A message that did not arrive is `open`, not lost,
    if the time left until then was shorter than the longest delay of a message with its name.
    """
    found: dict[str, KindOfMessages] = {}
    for (name,), group in sorted(sent.group_by("name", maintain_order=True)):
        longest = (group["arrived_ns"] - group["t_ns"]).max() or 0
        by_drone: dict[str, DroneMessages] = {}
        for drone, t_ns, arrived_ns in group.sort("drone").select("drone", "t_ns", "arrived_ns").iter_rows():
            count = by_drone.setdefault(str(drone), {"sent": 0, "lost": 0, "open": 0})
            count["sent"] += 1
            if arrived_ns is None:
                if t_ns is not None and t_ns + longest > until_ns.get(drone, 0):
                    count["open"] += 1
                else:
                    count["lost"] += 1
        lost = sum(count["lost"] for count in by_drone.values())
        still_open = sum(count["open"] for count in by_drone.values())
        found[str(name)] = {**loss_of(len(group), lost, still_open), "open": still_open, "drones": by_drone}
    return found
