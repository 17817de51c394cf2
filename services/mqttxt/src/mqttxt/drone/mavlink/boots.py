"""Whether an autopilot is still in the flight of before, or was started anew (docs/protocol.md, R5.26)."""

from __future__ import annotations

from typing import Any

SILENCE_MS = 200
"""A silence within which an autopilot may have started anew: a PX4 in simulation needs some 0.5 s, others longer."""
DISORDER_MS = 1000
"""How far back a time since the start may go without a new start: messages overtake each other."""
_TELL_TIME = frozenset({"ATTITUDE", "GLOBAL_POSITION_INT", "SYSTEM_TIME"})
"""Messages whose `time_boot_ms` is the moment at which they are written."""


class Boots:
    """Counts the restarts of one autopilot, by the time since its start that its messages have.

    After a silence `is_sure` is false until a message has such a time: a restarted autopilot says first that it is
    disarmed and on the ground, even in the air. `sure_ms` is then the last heartbeat before the silence.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self.is_sure = True
        self.sure_ms: int | None = None
        self._newest_ms: int | None = None

    def on_message(self, message: Any, silence_ms: int, heartbeat_ms: int | None) -> None:
        """A message came `silence_ms` after the one before; the last heartbeat before it was at `heartbeat_ms`."""
        if silence_ms > SILENCE_MS and self.is_sure and self._newest_ms is not None:
            self.is_sure, self.sure_ms = False, heartbeat_ms
        if message.get_type() not in _TELL_TIME:
            return
        told_ms, newest_ms = message.time_boot_ms, self._newest_ms
        is_new = newest_ms is not None and told_ms < newest_ms - DISORDER_MS
        self.restarts += is_new
        self._newest_ms = told_ms if is_new or newest_ms is None else max(told_ms, newest_ms)
        self.is_sure = True
