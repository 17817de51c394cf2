"""Frames that links lost, by cause: what the shaper counted, set against what the captures at both ends have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import polars as pl

from ..attempt_entry import Losses
from ..packets import Packets

CAUSES = ("random", "queue", "closed", "overload", "corrupted")
"""Drawn; no room in the link's queue; a closed link's refusals; the shaper did not keep up; a bit was turned."""
UNKNOWN = "unknown"
TOLERANCE_FRAMES = 2
"""By so many frames of a link both may differ: its first and last ones, which one of them saw and the other not."""


def losses(packets: Packets, counters: Mapping[str, Any] | None, start_ns: int | None = None) -> Losses:
    """Frames lost since the links' start, as the shaper counts them: over all links by cause, and for each link.

    `captured` is the captures' own count of frames that entered and did not leave unchanged; what of it no cause
    explains is `unknown`. Without counters all of it is. `open` are frames of which the captures ended too soon to
    tell. `start_ns` is when the mission let the links' clock begin:
    `at_start` in the counters is what was counted until then, which is left out, as the links' probes are in it. None:
    there was no such moment, and the whole run is counted.
    """
    told = counters["links"] if counters is not None else {}
    before = (counters or {}).get("at_start") or {} if start_ns is not None else {}
    captured = _count(packets, pl.col("lost"), start_ns or 0)
    under_way = _count(packets, pl.col("left_ns").is_null() & ~pl.col("lost"), start_ns or 0)
    links = {}
    for name in sorted({*told, *captured}):
        mine, earlier = told.get(name, {}), before.get(name, {})
        entry = {cause: max(0, int(mine.get(cause, 0)) - int(earlier.get(cause, 0))) for cause in CAUSES}
        seen = captured.get(name, 0)
        entry[UNKNOWN] = max(0, seen - sum(entry.values()))
        links[name] = {**entry, "captured": seen, "open": under_way.get(name, 0)}
    total = {key: sum(link[key] for link in links.values()) for key in (*CAUSES, UNKNOWN, "captured", "open")}
    some = {name: link for name, link in links.items() if any(link.values())}
    return cast("Losses", {**total, "links": some})


def disagreements(found: Mapping[str, Any], shaped: bool) -> list[str]:
    """Where the shaper and the captures differ by more than a few frames, a line each.

    A bit that was turned in a header's unmatched field does not show in the captures.
    """
    said = []
    for name, link in found["links"].items():
        counted = sum(link[cause] for cause in CAUSES)
        least, most = link["captured"] - TOLERANCE_FRAMES, link["captured"] + link["open"] + TOLERANCE_FRAMES
        if shaped and not least <= counted <= most + link["corrupted"]:
            said.append(f"{name}: the shaper counts {counted} frames lost, the captures {link['captured']}")
    return said


def _count(packets: Packets, which: pl.Expr, since_ns: int) -> dict[str, int]:
    """By link the frames of a kind that entered it from a moment on."""
    found = packets.frames.filter(which & (pl.col("t_ns") >= since_ns)).group_by(pl.col("link").cast(pl.String)).len()
    return dict(found.iter_rows())
