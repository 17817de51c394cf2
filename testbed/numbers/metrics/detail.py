"""Details of one attempt besides its metrics: each link's bytes per second and frames, and the readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from ...fly.results import Attempt
from ...plan.topology import place_of_link
from ..packets import Packets, load
from .readings import MeasuredValue, readings_of
from .shaping import read_shaping
from .window import SECOND_NS


@dataclass(frozen=True)
class PerLink:
    """By directed link: `rates`, the bytes that entered it in each second of the mission; `entered`, its frames since
    losses are counted, which is since the links' start (`since_start`) or the first capture.
    """

    rates: dict[str, tuple[int, ...]]
    entered: dict[str, int]
    since_start: bool


@dataclass(frozen=True)
class Detail:
    """An attempt's links and its sensors' values (None without sensors)."""

    per_link: PerLink
    measured: tuple[MeasuredValue, ...] | None


def detail_of(attempt: Attempt, start_ns: int, seconds: float) -> Detail:
    """The details of a mission that began at `start_ns` and took `seconds`; makes a missing packets table."""
    packets = load(attempt)
    readings = readings_of(attempt, packets)
    links = per_link(packets, start_ns, seconds, _losses_counted_from_ns(attempt))
    return Detail(links, readings.measured if readings is not None else None)


def per_link(packets: Packets, start_ns: int, seconds: float, counted_from_ns: int = 0) -> PerLink:
    """Rates and frames of each directed link; the mission's last second may be incomplete."""
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


def _losses_counted_from_ns(attempt: Attempt) -> int:
    """When the links' clock began, if the shaper recorded its counts until then (mostly probes); else 0."""
    return read_shaping(attempt).start_ns or 0
