"""The cost of TCP on the air links of a flown series: `python -m tests.bench.lean_tcp results/scenario-1/latest`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from testbed.errors import TestbedError
from testbed.fly.results import open_series
from testbed.numbers.metrics import mission_window
from testbed.numbers.packets import load

WAITS_NS = 40_000_000
"""Linux delays an acknowledgement at least this long for data on which it could ride (TCP_DELACK_MIN)."""


@dataclass(frozen=True)
class Frame:
    """A frame of one end of a connection: when it entered its link, its bytes, and those of TCP's payload."""

    t_ns: int
    size: int
    carried: int


@dataclass(frozen=True)
class Costs:
    """Frames and bytes per second; those of bare acknowledgements, and of ones soon followed by the same end's data."""

    frames: float
    bytes: float
    headers: float
    bare: float
    bare_bytes: float
    ridden: float

    def __str__(self) -> str:
        return (
            f"{self.frames:.1f} frames/s, {self.bytes:,.0f} B/s, TCP's headers {self.headers:,.0f} B/s, "
            f"bare acknowledgements {self.bare:.1f}/s with {self.bare_bytes:,.0f} B/s, "
            f"of which data follows {self.ridden:.2f}/s within {WAITS_NS // 1_000_000} ms"
        )


def followed(frames: Sequence[Frame]) -> int:
    """How many bare acknowledgements of one end could have waited for its next data, in frames in order of time."""
    found, next_ns = 0, None
    for frame in reversed(frames):
        if frame.carried:
            next_ns = frame.t_ns
        elif next_ns is not None and next_ns - frame.t_ns <= WAITS_NS:
            found += 1
    return found


def measure(path: Path) -> list[str]:
    """A line for each attempt over MQTT-XT. Raises ResultsError."""
    return [
        f"attempt {attempt.number}: {costs(attempt.path)}"
        for attempt in open_series(path).attempts()
        if attempt.protocol == "mqttxt"
    ]


def costs(path: Path) -> Costs:
    """The costs of an attempt, in the window of its mission."""
    attempt = next(one for one in open_series(path.parents[1]).attempts() if one.path == path)
    packets = load(attempt)
    window = mission_window(attempt, attempt.events(), packets)
    assert window is not None, f"{path}: no mission"
    air = packets.frames.filter(
        pl.col("link").cast(pl.String).str.starts_with("air:"), window.entered, pl.col("transport") > 8
    ).sort("t_ns")
    ends = air.with_columns(
        carried=pl.col("size") - pl.col("ethernet") - pl.col("ip") - pl.col("transport")
    ).partition_by("link", "flow")
    bare = pl.concat(ends).filter(pl.col("carried") == 0)
    rides = sum(followed([Frame(*row) for row in end.select("t_ns", "size", "carried").iter_rows()]) for end in ends)
    of = [len(air), air["size"].sum(), air["transport"].sum(), len(bare), bare["size"].sum(), rides]
    return Costs(*(float(count) / window.seconds for count in of))


if __name__ == "__main__":
    try:
        for said in sys.argv[1:]:
            print(said, *measure(Path(said)), sep="\n  ")
    except TestbedError as error:
        sys.exit(f"lean_tcp: {error}")
