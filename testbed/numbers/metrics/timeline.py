"""Traffic over time and by size: equations (1) and (2) per second, and packet sizes in Wireshark's bins."""

from __future__ import annotations

import numpy as np
import polars as pl

from ...fly.pcap import Ints
from ..attempt_entry import AmountEntry, Load, Retransmissions
from ..packets import Packets
from .ways import Ways
from .window import Window

_BINS = (0, 20, 40, 80, 160, 320, 640, 1280, 2560, 5120)
"""The least size of each of Wireshark's bins (Statistics > Packet Lengths)."""


def load(packets: Packets, ways: Ways, window: Window) -> Load:
    """Bytes in each second since the window's start: L(x), through fog x by drone, and their sum, TotalLoad.

    A drone's bytes through its fog are the frames that entered its air link in either direction. The last second may
    be incomplete.
    """
    frames = packets.frames.filter(window.entered).select(pl.col("link").cast(pl.String), "size", window.second)
    found: Load = {}
    total = np.zeros(window.whole_seconds, dtype=np.int64)
    for fog, drones in ways.fogs.items():
        by_drone = found[fog] = dict[str, list[int]]()
        for node in drones:
            own = frames.filter(pl.col("link").is_in(ways.both(node, fog)))
            series = _by_second(own, window)
            by_drone[node] = series.tolist()
            total += series
    return {**found, "total": total.tolist()}


def over_time(packets: Packets, window: Window) -> dict[str, list[int]]:
    """Bytes that entered links in either direction in each second, by class of link (wan, backhaul, air, sense)."""
    of = pl.col("link").cast(pl.String).str.split(":").list.first().alias("of")
    frames = packets.frames.filter(window.entered).select(of, "size", window.second)
    groups = sorted(frames.group_by("of", maintain_order=True))
    return {str(name): _by_second(own, window).tolist() for (name,), own in groups}


def _by_second(frames: pl.DataFrame, window: Window) -> Ints:
    """The bytes of frames (`size`) in each second of the window (`second`)."""
    sums = np.bincount(frames["second"].to_numpy(), weights=frames["size"].to_numpy(), minlength=window.whole_seconds)
    return sums.astype(np.int64)


def sizes(packets: Packets, window: Window) -> dict[str, int]:
    """Frames that entered any link in the window, by Wireshark's bins; empty bins are left out."""
    return histogram(packets.frames.filter(window.entered)["size"])


def histogram(sizes: pl.Series) -> dict[str, int]:
    """The number of sizes in each of Wireshark's bins; empty bins are left out."""
    place = np.searchsorted(np.array(_BINS), sizes.to_numpy(), side="right") - 1
    counts = np.bincount(place, minlength=len(_BINS)).tolist()
    return {_bin_name(number): count for number, count in enumerate(counts) if count}


def purposes(packets: Packets, window: Window) -> dict[str, AmountEntry]:
    """Bytes and frames by purpose. A frame counts for its first message; its bytes are divided among all messages that
    begin in it, in proportion to their length."""
    frames = packets.frames.with_row_index("frame").filter(window.entered)
    alone = frames.filter(pl.col("messages") <= 1).group_by("purpose").agg(pl.col("size").sum().alias("bytes"))
    several = frames.filter(pl.col("messages") > 1)
    parts = packets.messages.join(
        several.select(pl.col("frame").cast(pl.Int64), "size"), on="frame", how="inner", maintain_order="left"
    ).with_columns(pl.col("bytes").fill_null(0))
    up_to = pl.col("bytes").cum_sum().over("frame")
    whole = pl.max_horizontal(pl.col("bytes").sum().over("frame"), pl.lit(1))
    share = pl.col("size") * up_to // whole - pl.col("size") * (up_to - pl.col("bytes")) // whole
    shared = parts.with_columns(share.alias("part")).group_by("purpose").agg(pl.col("part").sum().alias("bytes"))
    counts = dict(frames.group_by(pl.col("purpose").cast(pl.String)).len().iter_rows())
    amounts: dict[str, int] = {}
    for table in (alone, shared):
        for purpose, amount in table.cast({"purpose": pl.String}).iter_rows():
            amounts[purpose] = amounts.get(purpose, 0) + int(amount)
    return {
        name: {"bytes": amounts.get(name, 0), "packets": counts.get(name, 0)} for name in sorted({*counts, *amounts})
    }


def retransmissions(packets: Packets, window: Window) -> Retransmissions:
    """Frames with what TCP or MQTT-SN sent before: their number, bytes, how many were needless, and by link."""
    again = packets.frames.filter(window.entered, pl.col("repeats").is_not_null())
    links = again.group_by(pl.col("link").cast(pl.String)).len().sort("link")
    return {
        "packets": len(again),
        "bytes": int(again["size"].sum()),
        "needless": int((again["repeats"].cast(pl.String) == "needless").sum()),
        "links": dict(links.iter_rows()),
    }


def _bin_name(number: int) -> str:
    if number + 1 == len(_BINS):
        return f"{_BINS[number]} and more"
    return f"{_BINS[number]}-{_BINS[number + 1] - 1}"
