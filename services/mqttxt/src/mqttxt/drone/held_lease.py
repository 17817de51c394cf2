"""The control lease that a drone's commands go by."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class HeldLease:
    """Until when the station with `holder_session` controls the drone, and may let an offboard command go on.

    Both in the session clock, None while there is no lease.
    """

    until_ms: int | None = None
    offboard_until_ms: int | None = None
    holder_session: int | None = None

    def is_held(self, now_ms: int) -> bool:
        return self.until_ms is not None and now_ms <= self.until_ms
