"""What is said beside an attempt's numbers: files cut off, foreign traffic, a clock that steps, counts that differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import polars as pl

from ..packets import Packets
from .causes import disagreements
from .shaping import Shaping
from .window import Window

_EVERYWHERE = {"arp", "ipv6", "igmp"}
"""What every network's own nodes send on their own ports."""
_STEP_BACK_NS = 50_000_000
"""A clock that goes back by more was set; less is the order in which a kernel hands frames or a program lines over."""


def notes(
    packets: Packets, shaping: Shaping, losses: Mapping[str, Any], window: Window, foreign: Mapping[str, int]
) -> list[str]:
    """One line each, nothing when there is nothing to say."""
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


def unsent_note(unsent: Mapping[str, int]) -> list[str]:
    """What drones sent and their own queues dropped, which no capture has."""
    each = ", ".join(f"{count} of drone {drone}" for drone, count in unsent.items())
    return (
        [f"messages dropped before they entered a link, by sequence numbers, of unknown kinds: {each}"] if each else []
    )


def clock_step(packets: Packets, logs: Mapping[str, Sequence[Mapping[str, Any]]]) -> str | None:
    """By how much the clock was set back during the attempt, where captures or events show it; None if it was not.

    `logs` are events by file, each in the order in which it was written.
    """
    steps = dict(packets.steps_back_ns)
    for name, events in logs.items():
        times = [int(event["t_ns"]) for event in events]
        steps[name] = max((before - after for before, after in pairwise(times)), default=0)
    worst = max(steps, key=lambda name: steps[name], default=None)
    if worst is None or steps[worst] < _STEP_BACK_NS:
        return None
    return f"the clock was set back by {steps[worst] / 1e9:.3f} s during the attempt ({worst})"
