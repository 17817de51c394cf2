"""The counters file: per link what came, what left and what was dropped for which cause; and whether the run stands."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from .link import Link
from .timing import Lateness

VERSION = 1
LATE_LIMIT_MS = 10.0
"""Later than this at p99, and the links were not those of the plan: three times what is asked of a quiet machine."""


def report(
    profile: str, links: Sequence[Link], drops: Mapping[int, int], overruns: int, late: Lateness, held: int
) -> dict[str, Any]:
    """The file's content; `drops` are the kernel's, by queue, which is the link's place.

    `void` is None, or why the run does not count.
    """
    for queue, link in enumerate(links):
        link.counters.overload = drops.get(queue, 0)
    lost = {link.name: link.counters.overload for link in links if link.counters.overload}
    p99_ms = late.quantile_ms(0.99)
    void = None
    if lost or overruns:
        named = ", ".join(f"{name} {count}" for name, count in lost.items()) or "a full socket"
        void = f"the emulator did not keep up: packets lost to overload: {named}"
    elif p99_ms > LATE_LIMIT_MS:
        void = f"the emulator did not keep up: {p99_ms:.1f} ms late at p99; expected {LATE_LIMIT_MS:g} at most"
    return {
        "version": VERSION,
        "shaper": "nfqueue",
        "profile": profile,
        "links": {link.name: asdict(link.counters) for link in links},
        "held": held,
        "late_ms": {
            "p50": late.quantile_ms(0.5),
            "p99": p99_ms,
            "max": late.greatest_ns / 1e6,
        },
        "void": void,
    }


def write(content: Mapping[str, Any], path: Path) -> None:
    """Whole or not at all."""
    fresh = path.with_suffix(".new")
    fresh.write_text(json.dumps(content, indent=1) + "\n")
    fresh.replace(path)
