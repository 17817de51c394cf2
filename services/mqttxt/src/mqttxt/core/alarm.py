"""Calls at a time of a session's clock, for what cannot wait for the next tick."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from .clock import SessionClock


class Alarm:
    """Rings once each time it was set; who is rung looks at what is due, and may set it again."""

    def __init__(self, clock: SessionClock, ring: Callable[[], None]) -> None:
        self._clock = clock
        self._ring = ring
        self._handle: asyncio.TimerHandle | None = None

    def set(self, due_ms: int | None) -> None:
        """Ring at this time, or before it where an earlier one is set; None: nothing is due."""
        if due_ms is not None and self._handle is None:
            pause_s = max(0, due_ms - self._clock.now_ms()) / 1000
            self._handle = asyncio.get_running_loop().call_later(pause_s, self._rung)

    def _rung(self) -> None:
        self._handle = None
        self._ring()
