"""Notes beside an attempt's numbers: files cut off, foreign traffic, counts that differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import polars as pl

from ..packets import Packets
from .causes import disagreements
from .shaping import Shaping
from .window import Window

MUCH = 0.25
"""From this share of the processors' time on other programs are noted; Docker and the testbed take some of it too."""
_EVERYWHERE = {"arp", "ipv6", "igmp"}
"""Kinds of frames that the nodes of every network send by themselves."""


def notes(
    packets: Packets, shaping: Shaping, losses: Mapping[str, Any], window: Window, foreign: Mapping[str, int]
) -> list[str]:
    """The notes on an attempt, one line each; empty if there are none."""
    said = [f"{name} was cut off; it is counted up to the cut" for name in packets.truncated]
    strangers = {kind: count for kind, count in foreign.items() if kind not in _EVERYWHERE}
    others = packets.frames.filter(window.entered, pl.col("purpose").cast(pl.String) == "other")
    if strangers:
        each = ", ".join(f"{count} {kind}" for kind, count in sorted(strangers.items()))
        said.append(f"frames from or to addresses of no node are not counted: {each}")
    if len(others):
        said.append(f"{len(others)} frames on links are of no message of the experiment")
    strays = packets.unmatched - packets.duplicates
    if strays and not packets.truncated:
        said.append(f"{strays} frames left a link that nobody saw entering it as they were")
    if shaping.is_shaped and shaping.measured and shaping.start_ns is None:
        said.append("losses by cause have those of the links' probes in them")
    return [*said, *shaping.notes, *disagreements(losses, shaping.is_shaped)]


def others_note(manifest: Mapping[str, Any]) -> list[str]:
    """For a flight beside programs that took much of the processors' time: its delays contain waiting for them."""
    share = manifest["host"].get("others", 0.0)
    if share < MUCH:
        return []
    return [f"other programs took {100 * share:.0f} % of the processors' time: delays contain waiting for them"]


def machines_note(manifest: Mapping[str, Any]) -> list[str]:
    """For a flight on several machines, the round trip to each besides all links."""
    ways = [f"{way['round_trip_ms']:.2f} ms to {way['machine']}" for way in manifest.get("machines", [])]
    return (
        [f"past all links the way from net and back took {', '.join(ways)}; delays are told by captures alone"]
        if ways
        else []
    )


def unsent_note(unsent: Mapping[str, int]) -> list[str]:
    """Messages that the drones' own queues dropped, which no capture has."""
    each = ", ".join(f"{count} of drone {drone}" for drone, count in unsent.items())
    return (
        [f"messages dropped before they entered a link, by sequence numbers, of unknown kinds: {each}"] if each else []
    )
