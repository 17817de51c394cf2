"""Whether an autopilot has been restarted since it was last heard (docs/protocol.md, R5.26)."""

from __future__ import annotations

from typing import Any

SILENCE_MS = 200
"""The longest silence in which no autopilot can restart: PX4 in simulation needs some 0.5 s, others longer."""
DISORDER_MS = 1000
"""How far the time since the start may go back without a restart: messages overtake each other."""
_TELL_TIME = frozenset({"ATTITUDE", "GLOBAL_POSITION_INT", "SYSTEM_TIME"})
"""Messages whose `time_boot_ms` is the time of their writing."""


class Boots:
    """Counts the restarts of one autopilot, by the time since its start in its messages.

    After a silence `is_sure` is false until a message with such a time arrives: a restarted autopilot first reports
    that it is disarmed and on the ground, even in the air. `sure_ms` is then the last heartbeat before the silence.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self.is_sure = True
        self.sure_ms: int | None = None
        self._newest_ms: int | None = None

    def on_message(self, message: Any, silence_ms: int, heartbeat_ms: int | None) -> None:
        """A message arrived `silence_ms` after the one before; the last heartbeat before it was at `heartbeat_ms`."""
        if silence_ms > SILENCE_MS and self.is_sure and self._newest_ms is not None:
            self.is_sure, self.sure_ms = False, heartbeat_ms
        if message.get_type() not in _TELL_TIME:
            return
        told_ms, newest_ms = message.time_boot_ms, self._newest_ms
        is_new = newest_ms is not None and told_ms < newest_ms - DISORDER_MS
        self.restarts += is_new
        self._newest_ms = told_ms if is_new or newest_ms is None else max(told_ms, newest_ms)
        self.is_sure = True
