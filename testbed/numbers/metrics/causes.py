"""Frames that links lost, by cause: the shaper's counts, compared with the captures at both ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import polars as pl

from ..attempt_entry import Losses
from ..packets import Packets

CAUSES = ("random", "queue", "closed", "overload", "corrupted")
"""Drawn at random; the link's queue was full; the link was closed; the shaper did not keep up; a bit was flipped."""
UNKNOWN = "unknown"
TOLERANCE_FRAMES = 2
"""By how many frames of a link the two may differ: the first and last ones, which only one of them has."""


def losses(packets: Packets, counters: Mapping[str, Any] | None, start_ns: int | None = None) -> Losses:
    """Frames lost since the links' start, as the shaper counts them: over all links by cause, and for each link.

    `captured` is the captures' own count of frames that entered a link and did not leave it unchanged. Those that no
    cause explains are `unknown`; without counters all are. `open` counts the frames that were on a link when the
    captures ended. `start_ns` is when the mission started the links' clock: the counts until then, `at_start` in the
    counters, are subtracted because they include the links' probes. None: the clock never started, and the whole run
    is counted.
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
    """List the links on which shaper and captures differ by more than TOLERANCE_FRAMES, one line each.

    Captures do not show a bit that was flipped in a header field by which frames are not matched.
    """
    said = []
    for name, link in found["links"].items():
        counted = sum(link[cause] for cause in CAUSES)
        least, most = link["captured"] - TOLERANCE_FRAMES, link["captured"] + link["open"] + TOLERANCE_FRAMES
        if shaped and not least <= counted <= most + link["corrupted"]:
            said.append(f"{name}: the shaper counts {counted} frames lost, the captures {link['captured']}")
    return said


def _count(packets: Packets, which: pl.Expr, since_ns: int) -> dict[str, int]:
    """Count by link the frames selected by `which` that entered it at `since_ns` or later."""
    found = packets.frames.filter(which & (pl.col("t_ns") >= since_ns)).group_by(pl.col("link").cast(pl.String)).len()
    return dict(found.iter_rows())
