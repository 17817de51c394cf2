"""MAVLink's log protocol towards an autopilot: its list of logs, and the bytes of one, window by window."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.logs import MOST_LOGS, FlightLog
from .plans import AUTOPILOT_COMPONENT

DATA_BYTES = 90
"""In one LOG_DATA."""
AGAIN_MS = 500
SILENT_ASKS = 14
SHORT_ANSWERS = 3
"""How often an autopilot may end a log before the size that it has listed."""
_ALL = 0xFFFF


class Listing:
    """One reading of an autopilot's list of logs. Once it `is_over`, either `found` or `error`, the reason, is set.

    PX4 counts logs from 0, ArduPilot from 1. If an entry is lost, the whole list is requested again.
    """

    def __init__(self, system: int) -> None:
        self.found: tuple[FlightLog, ...] | None = None
        self.error: str | None = None
        self._system = system
        self._entries: dict[int, FlightLog | None] = {}
        self._silent_asks = 0
        self._next_ms = 0

    @property
    def is_over(self) -> bool:
        return self.found is not None or self.error is not None

    def begin(self, now_ms: int) -> list[Any]:
        """Request the list."""
        self._next_ms = now_ms + AGAIN_MS
        return [mavlink.MAVLink_log_request_list_message(self._system, AUTOPILOT_COMPONENT, 0, _ALL)]

    def on_entry(self, message: Any, now_ms: int) -> None:
        """Take in a LOG_ENTRY. That of an empty log counts as an entry, but is left out of `found`."""
        if self.is_over:
            return
        if message.num_logs > MOST_LOGS:
            self.error = f"too_many, {message.num_logs}"
            return
        if message.num_logs == 0:
            self.found = ()
            return
        if message.id not in self._entries:
            self._silent_asks, self._next_ms = 0, now_ms + AGAIN_MS
        log = FlightLog(message.id, message.size, message.time_utc or None) if message.size > 0 else None
        self._entries[message.id] = log
        if len(self._entries) >= message.num_logs:
            told = (self._entries[number] for number in sorted(self._entries))
            self.found = tuple(one for one in told if one is not None)

    def due(self, now_ms: int) -> list[Any]:
        """The repeated request, if it is due."""
        if self.is_over or now_ms < self._next_ms:
            return []
        self._silent_asks += 1
        if self._silent_asks >= SILENT_ASKS:
            self.error = "no_answer"
            return []
        return self.begin(now_ms)


class Window:
    """The bytes of a log from `start` up to, and without, `end`: requested at once, and missing ones again.

    `is_whole` once `data` has all of them; `error` is the reason why it never will.
    """

    def __init__(self, system: int, log: FlightLog, start: int, end: int) -> None:
        self.start, self.end = start, end
        self.error: str | None = None
        self._system = system
        self._log = log
        self._pieces: dict[int, bytes] = {}
        self._asked_end = start
        self._silent_asks = self._short_answers = 0
        self._next_ms = 0

    @property
    def is_whole(self) -> bool:
        return len(self._pieces) == len(range(self.start, self.end, DATA_BYTES))

    @property
    def data(self) -> bytes:
        return b"".join(self._pieces[offset] for offset in sorted(self._pieces))

    def ask(self, now_ms: int) -> list[Any]:
        """Request the first run of missing bytes."""
        missing = [offset for offset in range(self.start, self.end, DATA_BYTES) if offset not in self._pieces]
        first = end = missing[0]
        while end in missing:
            end += DATA_BYTES
        self._asked_end, self._next_ms = min(end, self.end), now_ms + AGAIN_MS
        return [
            mavlink.MAVLink_log_request_data_message(
                self._system, AUTOPILOT_COMPONENT, id=self._log.number, ofs=first, count=self._asked_end - first
            )
        ]

    def on_data(self, message: Any, now_ms: int) -> list[Any]:
        """Take in a LOG_DATA. After the last requested one, request the missing bytes again.

        Not after a copy: behind a request that was repeated the autopilot's whole answer comes twice.
        """
        offset = message.ofs
        is_one = message.id == self._log.number and offset in range(self.start, self.end, DATA_BYTES)
        if not is_one or self.is_whole or self.error is not None:
            return []
        wanted = min(DATA_BYTES, self.end - offset)
        if message.count < wanted:
            self._short_answers += 1
            if self._short_answers >= SHORT_ANSWERS:
                self.error = "changed_meanwhile"
            return []
        if offset in self._pieces:
            return []
        self._silent_asks, self._next_ms = 0, now_ms + AGAIN_MS
        self._pieces[offset] = bytes(message.data[:wanted])
        if self.is_whole or offset + wanted < self._asked_end:
            return []
        return self.ask(now_ms)

    def due(self, now_ms: int) -> list[Any]:
        """The repeated request, if nothing has arrived for `AGAIN_MS`."""
        if self.is_whole or self.error is not None or now_ms < self._next_ms:
            return []
        self._silent_asks += 1
        if self._silent_asks >= SILENT_ASKS:
            self.error = "no_answer"
            return []
        return self.ask(now_ms)


def end_message(system: int) -> Any:
    """LOG_REQUEST_END: ArduPilot then resumes its own logging, and PX4 closes the file."""
    return mavlink.MAVLink_log_request_end_message(system, AUTOPILOT_COMPONENT)
