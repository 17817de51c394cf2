"""Requests to the folder of logs, and their results.

`turn` is the reader's number of a request, by which it recognises the result of one that it has given up.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..protocol.bulk import BulkAsk, Get
from ..protocol.logs import FlightLog
from .mavlink.log_protocol import DATA_BYTES

BLOCK_BYTES = 728 * DATA_BYTES
"""How much is written at a time. It is on the disk before more is read."""
TAIL_BYTES = 10 * DATA_BYTES
"""How many of a partly read log's last bytes the autopilot has to send again before reading resumes there."""


@dataclass(frozen=True)
class WholeLog:
    """A log as stations fetch it: compressed, `size` bytes with the hash `hash`."""

    hash: bytes
    size: int


@dataclass(frozen=True)
class OpenLog:
    """Look up how much of a log is stored; `sure` bytes are known to be on the disk. LogOpened follows."""

    turn: int
    log: FlightLog
    sure: int = 0


@dataclass(frozen=True)
class WriteLog:
    """Write bytes of a log at `offset`, and end the file there; LogWritten follows once they are on the disk."""

    turn: int
    log: FlightLog
    offset: int
    data: bytes


@dataclass(frozen=True)
class FinishLog:
    """Compress a log that was read as a whole, for stations to fetch; LogFinished follows."""

    turn: int
    log: FlightLog


@dataclass(frozen=True)
class DropLog:
    """Remove a partly read log; nothing follows."""

    log: FlightLog


@dataclass(frozen=True)
class LoadLog:
    """Load the bytes of a whole log that a station asks for; LogLoaded follows."""

    ask: BulkAsk
    get: Get
    hash: bytes
    log: FlightLog


LogWork = OpenLog | WriteLog | FinishLog | DropLog | LoadLog


@dataclass(frozen=True)
class LogOpened:
    """The first `done` bytes of a log are stored, of which `tail` are the last; or the log is `whole`."""

    turn: int
    done: int
    tail: bytes
    whole: WholeLog | None = None


@dataclass(frozen=True)
class LogWritten:
    """The bytes are on the disk."""

    turn: int


@dataclass(frozen=True)
class LogFinished:
    """Stations can fetch the log."""

    turn: int
    whole: WholeLog


@dataclass(frozen=True)
class LogFault:
    """Writing or reading a log failed: `reason` is for the station, `detail` for the UAV client's log."""

    turn: int
    reason: str
    detail: str


@dataclass(frozen=True)
class LogLoaded:
    """The bytes that `ask` requested, of a log of `size` bytes; None if the log no longer exists."""

    ask: BulkAsk
    get: Get
    hash: bytes
    data: bytes | None
    size: int


LogDone = LogOpened | LogWritten | LogFinished | LogFault | LogLoaded
