"""An autopilot's flight logs, and its side of MAVLink's log protocol on one link; no I/O."""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from pymavlink.dialects.v20 import development as mavlink

if TYPE_CHECKING:
    from .autopilot import Autopilot

DATA_BYTES = 90
AT_ONCE = 40
"""LOG_DATA messages per step, as in ArduPilot's simulation."""
MADE_UP = ((1_767_225_600, 40_000), (1_767_229_200, 120_000))
"""Times (since 1970) and sizes of the logs that exist at the start."""
MESSAGES = frozenset({"LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_REQUEST_END", "LOG_ERASE"})


@dataclass
class Log:
    """One log: its time in seconds since 1970, and its bytes."""

    time_s: int
    data: bytes


def made_up(time_s: int, size: int) -> Log:
    """A log of random bytes, half of them zeros, the same each time."""
    rng = random.Random(size)
    return Log(time_s, b"".join(rng.randbytes(4) + bytes(4) for _ in range(size // 8 + 1))[:size])


@dataclass
class Logs:
    """The logs of one autopilot, in the order of their numbers."""

    kept: list[Log] = field(default_factory=lambda: [made_up(*one) for one in MADE_UP])


class LogLink(ABC):
    """The protocol on one link. Log numbers count from `first`."""

    first: ClassVar[int]

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self._logs = autopilot.logs
        self._entries: list[int] = []
        self._sent: Log | None = None
        self._number = self._offset = self._end = 0

    @abstractmethod
    def answer(self, message: Any) -> None:
        """Take one of MESSAGES; `due` returns the answers."""

    def due(self) -> list[Any]:
        """The messages to send in this step."""
        out = [self._entry(number) for number in self._entries]
        self._entries = []
        for _ in range(AT_ONCE):
            if self._sent is None:
                break
            out.append(self._data(self._sent))
        return out

    def _list(self, message: Any) -> None:
        count = len(self._logs.kept)
        last = min(message.end, self.first + count - 1)
        self._entries = [*range(max(message.start, self.first), last + 1)] if count else [0]

    def _begin(self, message: Any) -> None:
        """Begin to send bytes of a log, if it exists."""
        index = message.id - self.first
        if not 0 <= index < len(self._logs.kept):
            self._sent = None
            return
        self._sent, self._number, self._offset = self._logs.kept[index], message.id, message.ofs
        self._end = min(len(self._sent.data), message.ofs + message.count)

    def _entry(self, number: int) -> Any:
        kept = self._logs.kept
        log = kept[number - self.first] if kept else Log(0, b"")
        last = self.first + len(kept) - 1 if kept else 0
        return mavlink.MAVLink_log_entry_message(number, len(kept), last, log.time_s, len(log.data))

    def _data(self, log: Log) -> Any:
        data = log.data[self._offset : min(self._end, self._offset + DATA_BYTES)]
        filled = [*data, *bytes(DATA_BYTES - len(data))]
        message = mavlink.MAVLink_log_data_message(self._number, self._offset, len(data), filled)
        self._offset += len(data)
        if len(data) < DATA_BYTES or self._offset >= self._end:
            self._sent = None
        return message
