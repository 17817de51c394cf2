"""An attempt's messages end to end, for either protocol: each command and each state, when it left and when it came."""

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
    **{"name": pl.String(), "drone": pl.Int64(), "t_ns": pl.Int64(), "arrived_ns": pl.Int64(), "frame": pl.Int64()},
})  # fmt: skip
"""A row for each message sent: the command's or state's name, the drone it goes to or comes from, when its first frame
left its origin (null: it never did), when its first copy reached the far end (null: none did), and the row of that
first frame in the packets table."""
SAME_MESSAGE_NS = 300_000_000_000
"""A key that comes again after a longer time names another message: MQTT-XT's stamps begin again after 655 s."""


@dataclass(frozen=True)
class Exchange:
    """Commands and states of the window, as `SENT` has them.

    `frames_per_call` is the mean number of frames that left the ground station for a call, repetitions included.
    `left_ns` is when the ground station took its leave, after which nobody sends it states (None: it did not).
    """

    commands: pl.DataFrame = field(default_factory=SENT.to_frame)
    states: pl.DataFrame = field(default_factory=SENT.to_frame)
    frames_per_call: dict[str, float] = field(default_factory=dict)
    left_ns: int | None = None

    def states_until_ns(self, packets: Packets, ways: Ways) -> dict[int, int]:
        """Until when states could come, by drone: while the station's capture ran and the station had not left."""
        captured_ns = packets.until_ns[STATION]
        return dict.fromkeys(ways.drones, captured_ns if self.left_ns is None else min(captured_ns, self.left_ns))


def calls_in(events: list[dict[str, Any]], window: Window) -> list[dict[str, Any]]:
    """The API calls of the mission in the order of time."""
    calls = [e for e in events if e["event"] == "command" and window.asked_ns <= e["t_ns"] <= window.end_ns]
    return sorted(calls, key=lambda call: int(call["t_ns"]))


def mean_frames(calls: list[dict[str, Any]], frames: Counter[str]) -> dict[str, float]:
    """Frames for each call, by command; a call for which no frame left counts too."""
    asked = Counter(str(call["command"]) for call in calls)
    return {command: round(frames[command] / count, 3) for command, count in asked.items()}


def with_arrivals(sent: pl.DataFrame, arrived: pl.DataFrame, by: list[str], repeats: bool) -> pl.DataFrame:
    """`sent` with the column `arrived_ns`: when the first copy of each message came, null where none did.

    `sent` has the columns `by` and `t_ns`, `arrived` has `by` and `arrived_ns`; each copy belongs to the last message
    of its key that was sent before it. `repeats`: a key that is sent again soon is the same message.
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
    """By name how many were sent and lost, and for each drone.

    What has not come is `open`, not lost, if it left so late that no message of its name was as slow as the time that
    was left until `until_ns`: the time, by drone, until which the far end could take it.
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
