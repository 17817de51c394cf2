"""What is asked of the folder of logs, and what comes of it.

`turn` is the reader's own number of what it asked for, so that an answer to what was given up is known as such.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..protocol.bulk import BulkAsk, Get
from ..protocol.logs import FlightLog
from .mavlink.log_protocol import DATA_BYTES

BLOCK_BYTES = 728 * DATA_BYTES
"""What is written at a time, and is on the disk before more is read."""
TAIL_BYTES = 10 * DATA_BYTES
"""The last bytes of a log that was read in part: the autopilot has to give them again before it goes on there."""


@dataclass(frozen=True)
class WholeLog:
    """A log as it is handed on: compressed, `size` bytes with the hash `hash`."""

    hash: bytes
    size: int


@dataclass(frozen=True)
class OpenLog:
    """Look what there is of a log, of which `sure` bytes are on the disk; LogOpened follows."""

    turn: int
    log: FlightLog
    sure: int = 0


@dataclass(frozen=True)
class WriteLog:
    """Write bytes of a log at `offset`, with nothing behind them; LogWritten follows once they are on the disk."""

    turn: int
    log: FlightLog
    offset: int
    data: bytes


@dataclass(frozen=True)
class FinishLog:
    """Make the log that is handed on of one that is there as a whole; LogFinished follows."""

    turn: int
    log: FlightLog


@dataclass(frozen=True)
class DropLog:
    """Remove what was read of a log; nothing follows."""

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
    """The first `done` bytes of a log are there, of which `tail` are the last; or the log is `whole`."""

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
    """The log can be handed on."""

    turn: int
    whole: WholeLog


@dataclass(frozen=True)
class LogFault:
    """The folder did not take or give a log: `reason` is for the station, `detail` for a person."""

    turn: int
    reason: str
    detail: str


@dataclass(frozen=True)
class LogLoaded:
    """The bytes that `ask` asked for, of a log of `size` bytes; None where that is not there any more."""

    ask: BulkAsk
    get: Get
    hash: bytes
    data: bytes | None
    size: int


LogDone = LogOpened | LogWritten | LogFinished | LogFault | LogLoaded
