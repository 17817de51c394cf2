"""What an attempt's packets table says of each link: bytes of each second, frames in the whole run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from ...packets import Packets
from ..details import place_of_link

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class PerLink:
    """By directed link: `rates`, the bytes that entered it in each second of the mission; `entered`, its frames from
    when losses were counted on, which is the links' start (`since_start`) or the first capture.
    """

    rates: dict[str, tuple[int, ...]]
    entered: dict[str, int]
    since_start: bool


def per_link(packets: Packets, start_ns: int, seconds: float, counted_from_ns: int = 0) -> PerLink:
    """The last second of the mission may be a part of one."""
    count = max(1, int(np.ceil(seconds)))
    frames = packets.frames.select(
        pl.col("link").cast(pl.String), "size", ((pl.col("t_ns") - start_ns) // SECOND_NS).alias("second"), "t_ns"
    )
    counted = frames.filter(pl.col("t_ns") >= counted_from_ns)
    entered = dict(counted.group_by("link").len().sort("link").iter_rows())
    within = frames.filter(pl.col("t_ns").is_between(start_ns, start_ns + int(seconds * SECOND_NS)))
    rates = {}
    for name in sorted(frames["link"].unique().to_list(), key=place_of_link):
        own = within.filter(pl.col("link") == name)
        at = np.minimum(own["second"].to_numpy(), count - 1)
        sums = np.bincount(at, weights=own["size"].to_numpy(), minlength=count)
        rates[name] = tuple(int(value) for value in sums)
    return PerLink(rates, entered, counted_from_ns > 0)
