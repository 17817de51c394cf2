"""An autopilot's flight logs on the wire: the list of logs, and the name of each (section 18)."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Final

from ..errors import PayloadError
from .fields import U16, VERSION, Integer, Items, Version
from .packing import pack, unpack

LOGS = "logs"
"""The kind of the list of logs among the objects that are carried in pieces."""
MOST_LOGS = 2000
_LARGEST = 2**32 - 1
_KIND: Final = re.compile(r"log\.(\d{1,5})\.(\d{1,10})\.(\d{1,10})", re.ASCII)


@dataclass(frozen=True)
class FlightLog:
    """A log as the autopilot lists it: its `number`, which another log may have after a start or an erasure.

    `size` is in bytes. `time_s` is its time by the autopilot's clock, in seconds since 1970, None where that is not
    known.
    """

    number: U16
    size: Annotated[int, Integer(1, _LARGEST)]
    time_s: Annotated[int, Integer(1, _LARGEST)] | None = None

    @property
    def kind(self) -> str:
        """The kind of the log itself among the objects that are carried in pieces."""
        return f"log.{self.number}.{self.size}.{self.time_s or 0}"

    @classmethod
    def of_kind(cls, kind: str) -> FlightLog | None:
        """The log that a kind of object names; None for any other kind."""
        found = _KIND.fullmatch(kind)
        if found is None:
            return None
        number, size, time_s = map(int, found.groups())
        if number >= 2**16 or not 0 < size <= _LARGEST or time_s > _LARGEST:
            return None
        log = cls(number, size, time_s or None)
        return log if log.kind == kind else None


@dataclass(frozen=True, kw_only=True)
class LogsObject:
    """The logs that an autopilot has, in the order of their numbers. The object travels compressed (RFC 1950)."""

    version: Version = VERSION
    logs: Annotated[tuple[FlightLog, ...], Items(MOST_LOGS)]


def pack_logs(logs: Iterable[FlightLog]) -> bytes:
    """A list of logs as an object. Raises PayloadError for too many."""
    return pack(LogsObject(logs=tuple(logs)), LOGS)


def unpack_logs(data: bytes) -> tuple[FlightLog, ...]:
    """The logs in an object. Raises PayloadError, also if two have one number."""
    logs = unpack(LogsObject, data, LOGS).logs
    if len({log.number for log in logs}) < len(logs):
        raise PayloadError(f"{LOGS}: expected each number once")
    return logs
