"""The counters file: packets per link that entered, left, and were dropped by cause; and whether the run is void."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from .link import EmulatedLink
from .timing import Lateness

VERSION = 1
LATE_LIMIT_MS = 10.0
"""The limit of lateness at p99, beyond which links are not as planned: three times that for a quiet machine."""


def by_link(links: Sequence[EmulatedLink], drops: Mapping[int, int]) -> dict[str, dict[str, int]]:
    """The counts of each link so far; `drops` are the kernel's by queue number, the link's index."""
    for queue, link in enumerate(links):
        link.counters.overload = drops.get(queue, 0)
    return {link.name: asdict(link.counters) for link in links}


def report(
    profile: str,
    links: Sequence[EmulatedLink],
    drops: Mapping[int, int],
    overruns: int,
    late: Lateness,
    held: int,
    at_start: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The file's content: totals, and their values when the links' clock began.

    `void` is None, or why the run does not count.
    """
    counted = by_link(links, drops)
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
        "links": counted,
        "at_start": at_start,
        "held": held,
        "late_ms": {
            "p50": late.quantile_ms(0.5),
            "p99": p99_ms,
            "max": late.greatest_ns / 1e6,
        },
        "void": void,
    }


class Writer:
    """Writes the file, completely or not at all, on its own thread: a slow disk must not delay packets."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._threads = ThreadPoolExecutor(max_workers=1)
        self._last: Future[None] | None = None

    def write(self, content: Mapping[str, Any]) -> None:
        """Begin to write, unless the last write is still in progress. Raises OSError if that one failed."""
        if self._last is None or self._last.done():
            self._settle()
            text = json.dumps(content) + "\n"  # indented it would take ten times as long, while packets wait
            self._last = self._threads.submit(self._replace, text)

    def finish(self, content: Mapping[str, Any]) -> None:
        """Write, and wait until it is done. Raises OSError."""
        self._settle()
        self._last = None
        self.write(content)
        self._settle()
        self._threads.shutdown()

    def _settle(self) -> None:
        if self._last is not None:
            self._last.result()

    def _replace(self, text: str) -> None:
        fresh = self._path.with_suffix(".new")
        fresh.write_text(text)
        fresh.replace(self._path)
