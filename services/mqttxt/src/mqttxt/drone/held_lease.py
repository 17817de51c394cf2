"""The control lease of a drone."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class HeldLease:
    """The ends of the control that the station with `holder_session` has, and of its offboard commands.

    Both are ms of the session clock, None without a lease.
    """

    until_ms: int | None = None
    offboard_until_ms: int | None = None
    holder_session: int | None = None

    def is_held(self, now_ms: int) -> bool:
        return self.until_ms is not None and now_ms <= self.until_ms
