"""When the gateway's process stood still: what its clients sent meanwhile is old, and is not executed."""

from __future__ import annotations

import logging

from ..core.hearing import STALL_MS

logger = logging.getLogger("mqttxt.gateway")

DRAINING_MS = 500
"""How long a process that stood still takes to read what its clients have sent meanwhile."""
LONGEST_DRAINING_MS = 3_000
"""More than a socket's buffer takes to read: later messages are new ones, however many they are."""
MOST_PER_TICK = 20
"""Messages in one tick above which they are those that waited: clients send a few per second, as they come."""


class Standstill:
    """Whether the process stood still, and still reads what waited in that time. Times are of the gateway's clock."""

    def __init__(self) -> None:
        self._ticked_ms = self._stalled_ms = self._late_until_ms = self._late = 0

    def is_over(self, now_ms: int) -> bool:
        """A tick begins; returns whether the process stood still since the last one."""
        pause_ms = now_ms - self._ticked_ms
        has_stalled = pause_ms > STALL_MS
        if has_stalled:
            logger.warning("stood still for %.1f s: what clients sent meanwhile is not executed", pause_ms / 1000)
            self._stalled_ms = now_ms
        is_draining = self._late > MOST_PER_TICK and now_ms < self._stalled_ms + LONGEST_DRAINING_MS
        if has_stalled or is_draining:
            self._late_until_ms = now_ms + DRAINING_MS
        self._ticked_ms, self._late = now_ms, 0
        return has_stalled

    def is_late(self, now_ms: int) -> bool:
        """Whether a message that is read now may have waited while the process stood still."""
        is_late = now_ms < self._late_until_ms or now_ms - self._ticked_ms > STALL_MS
        self._late += is_late
        return is_late
