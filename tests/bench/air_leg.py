"""The cost of the air links of flown series, and the age of states on them: `python -m tests.bench.air_leg FOLDER…`.

In the window of the mission, over MQTT-XT, by either kind of air leg (`AIR`): bytes per drone and second, both ways;
how long commands take down the link; how old the newest location at the fog is at worst, since its frame entered the
link, before the next one arrives. Over TCP, data behind a lost segment arrives with that segment.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import polars as pl

from testbed.errors import ResultsError, TestbedError
from testbed.fly.results import Attempt, open_series
from testbed.numbers.metrics import mission_window
from testbed.numbers.packets import load

_UDP = 8
"""Bytes of a UDP header."""
_NAMES = ("location", "states")
"""Topics that carry the location: its own, and a bundle's."""


@dataclass(frozen=True)
class Leg:
    """One attempt: bytes per drone and second; commands' delays and locations' ages in ms, each median and worst."""

    bytes_per_s: float
    command_ms: float
    slowest_ms: float
    age_ms: float
    oldest_ms: float

    def __str__(self) -> str:
        return (
            f"{self.bytes_per_s:.0f} B per drone and second; commands {self.command_ms:.0f} ms, at most "
            f"{self.slowest_ms:.0f}; oldest location {self.age_ms:.0f} ms at the median drone, "
            f"at most {self.oldest_ms:.0f}"
        )


def oldest_ns(ways: Iterable[tuple[int, int]]) -> int:
    """The greatest age of the newest message, from messages' starts and arrivals; 0 for fewer than two."""
    oldest = newest = 0
    for entered, left in sorted(ways, key=lambda way: way[1]):
        oldest = max(oldest, left - newest if newest else 0)
        newest = max(newest, entered)
    return oldest


def leg(attempt: Attempt) -> Leg:
    """Measure an attempt. Raises ResultsError for one without a mission, a command or a location."""
    packets = load(attempt)
    window = mission_window(attempt, attempt.events(), packets)
    if window is None:
        raise ResultsError(f"{attempt.path}: no mission")
    link = pl.col("link").cast(pl.String)
    frames = packets.frames.filter(link.str.starts_with("air:"), window.entered)
    rows = packets.frames.with_row_index("frame").select(pl.col("frame").cast(pl.Int64), "transport")
    told = packets.messages.filter(link.str.starts_with("air:"), window.entered, pl.col("left_ns").is_not_null())
    in_order = pl.col("left_ns").cum_max().over("link")
    told = (
        told.join(rows, on="frame")
        .sort("t_ns")
        .with_columns(left_ns=pl.when(pl.col("transport") > _UDP).then(in_order).otherwise(pl.col("left_ns")))
    )
    drones = frames["link"].cast(pl.String).str.split(":").list.get(1).n_unique()
    down = told.filter(pl.col("purpose") == "command", link.str.ends_with(":down"))
    delays = ((down["left_ns"] - down["t_ns"]) / 1e6).sort()
    last = pl.col("topic").str.split("/").list.last()
    places = told.filter(pl.col("purpose") == "state", last.is_in(_NAMES), link.str.ends_with(":up"))
    ages = pl.Series([oldest_ns(of.select("t_ns", "left_ns").iter_rows()) / 1e6 for of in places.partition_by("link")])
    if delays.is_empty() or ages.is_empty():
        raise ResultsError(f"{attempt.path}: no command or no location on an air link")
    per_s = float(frames["size"].sum()) / window.seconds / drones
    return Leg(per_s, _median(delays), delays.to_list()[-1], _median(ages), max(ages.to_list()))


def _median(values: pl.Series) -> float:
    return float(median(values.to_list()))


def measure(path: Path) -> list[str]:
    """A line for each completed attempt over MQTT-XT. Raises ResultsError."""
    return [
        f"attempt {attempt.number}: {leg(attempt)}"
        for attempt in open_series(path).attempts()
        if attempt.protocol == "mqttxt" and attempt.manifest()["status"] == "completed"
    ]


if __name__ == "__main__":
    try:
        for said in sys.argv[1:]:
            print(said, *measure(Path(said)), sep="\n  ")
    except TestbedError as error:
        sys.exit(f"air_leg: {error}")
