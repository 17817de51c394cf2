"""Reads the autopilot's logs when a station asks for one: only while disarmed, in small pieces (section 18)."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto
from itertools import count
from typing import Any

from ...protocol.bulk import Making, Unchanged
from ...protocol.logs import FlightLog, pack_logs
from ...protocol.states import Armed
from ..effects import Transmit
from ..log_work import (
    BLOCK_BYTES,
    DropLog,
    FinishLog,
    LogDone,
    LogFault,
    LogFinished,
    LogOpened,
    LogWritten,
    OpenLog,
    WholeLog,
    WriteLog,
)
from ..mavlink.log_protocol import DATA_BYTES, Listing, Window, end_message
from ..mavlink.vehicle import Vehicle
from ..runs import Output

LEAST_MESSAGES, MOST_MESSAGES = 10, 64
"""LOG_DATA requested at a time: as many as the last request would have brought within WINDOW_MS."""
WINDOW_MS = 200
MOST_BYTES_S = 65_536
"""The most bytes that are read of an autopilot per second."""
WAY_MS = 2000
"""How long nothing is requested after a command has arrived."""
WANTED_MS = 60_000
"""How long a log is read after a station's last request for it."""
FRESH_MS = 1000
"""How long a list of logs that was read is given out."""


class _Phase(Enum):
    """The phase of reading a log.

    WAITING until `WAY_MS` after a command; OPENING: how much of it is stored; LISTING: whether the autopilot has it;
    PROVING: whether it sends the last stored bytes again; READING; WRITING; CHECKING: whether it still has it;
    FINISHING; OVER.
    """

    WAITING = auto()
    OPENING = auto()
    LISTING = auto()
    PROVING = auto()
    READING = auto()
    WRITING = auto()
    CHECKING = auto()
    FINISHING = auto()
    OVER = auto()


_AT_AUTOPILOT = frozenset({_Phase.LISTING, _Phase.PROVING, _Phase.READING, _Phase.WRITING, _Phase.CHECKING})


@dataclass
class _Job:
    """One log that is read: `done` bytes of it are on the disk, and `block` are the next ones, not written yet."""

    log: FlightLog
    asked_ms: int
    restarts: int
    turn: int = 0
    phase: _Phase = _Phase.WAITING
    next_ms: int = 0
    done: int = 0
    tail: bytes = b""
    block: bytearray = field(default_factory=bytearray)
    window: Window | None = None
    window_ms: int = 0
    result: WholeLog | str | None = None


class LogReader:
    """Reads one autopilot's logs. Requests to the disk are returned as effects, and `on_done` takes their results."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._job: _Job | None = None
        self._listing: Listing | None = None
        self._listed: Listing | None = None
        self._listed_ms = 0
        self._is_list_wanted = False
        self._quiet_until_ms = 0
        self._messages = LEAST_MESSAGES
        self._turns = count(1)

    # -- requests of stations -------------------------------------------------------------------------------

    def listed(self, now_ms: int, known: bytes | None = None) -> bytes | str | Unchanged | None:
        """The list of logs, packed, or why there is none; None while it is read."""
        reason = self._refusal(now_ms)
        if reason is not None:
            return reason
        listed = self._listed
        if listed is not None and now_ms - self._listed_ms <= FRESH_MS:
            return listed.error if listed.found is None else pack_logs(listed.found)
        self._is_list_wanted = True
        return None

    def want(self, log: FlightLog, now_ms: int) -> None:
        """Start or continue reading a log for a station. One is read at a time, the one requested last."""
        job = self._job
        if job is not None and job.log == log and job.phase is not _Phase.OVER:
            job.asked_ms = now_ms
        else:
            done = job.done if job is not None and job.log == log else 0
            self._job = _Job(log, now_ms, self._vehicle.boots.restarts, done=done)

    def progress(self, log: FlightLog) -> WholeLog | Making | str:
        """The progress of a requested log: the whole log, how much of it is read, or the reason of a failure."""
        job = self._job
        if job is None or job.log != log:
            return "other_log_wanted"
        if job.result is not None:
            return job.result
        return Making(min(log.size, job.done + len(job.block)), log.size)

    # -- events ---------------------------------------------------------------------------------------------

    def give_way(self, now_ms: int) -> list[Output]:
        """Stop reading for a command: the autopilot shall do nothing else, and ArduPilot may not arm while it sends."""
        self._quiet_until_ms = now_ms + WAY_MS
        return self._break_off()

    def on_message(self, message: Any, now_ms: int) -> list[Output]:
        """A message of the autopilot."""
        kind = message.get_type()
        if kind not in ("LOG_ENTRY", "LOG_DATA") or not self._vehicle.is_own(message):
            return []
        job = self._job
        if kind == "LOG_ENTRY" and self._listing is not None:
            self._listing.on_entry(message, now_ms)
            return self._go_on(now_ms)
        if kind == "LOG_DATA" and job is not None and job.window is not None:
            missing = job.window.on_data(message, now_ms)
            out: list[Output] = [Transmit(one) for one in missing if self._vehicle.is_alive(now_ms)]
            return out + self._go_on(now_ms)
        return []

    def tick(self, now_ms: int) -> list[Output]:
        """Send what is due by time, and stop what the autopilot's state forbids."""
        if self._job is None and self._listing is None and not self._is_list_wanted:
            return []
        job, reason = self._job, self._refusal(now_ms)
        out: list[Output] = []
        if reason is not None:
            self._is_list_wanted = False
            if job is not None and job.phase in _AT_AUTOPILOT:
                out += self._end(reason)
            elif self._listing is not None:
                out += self._break_off()
        if job is not None and job.phase is not _Phase.OVER:
            if now_ms - job.asked_ms > WANTED_MS:
                out += self._end("not_wanted")
            elif job.restarts != self._vehicle.boots.restarts:
                job.restarts = self._vehicle.boots.restarts
                out += self._break_off()
        if not self._vehicle.is_alive(now_ms):
            return out
        if self._listing is not None:
            out += [Transmit(one) for one in self._listing.due(now_ms)]
        if job is not None and job.window is not None:
            out += [Transmit(one) for one in job.window.due(now_ms)]
        return out + self._go_on(now_ms)

    def on_done(self, done: LogDone, now_ms: int) -> list[Output]:
        """Go on after a result from the disk."""
        job = self._job
        if (
            job is None
            or not isinstance(done, LogOpened | LogWritten | LogFinished | LogFault)
            or done.turn != job.turn
        ):
            return []
        if isinstance(done, LogFault):
            return self._end(done.reason)
        if isinstance(done, LogOpened):
            job.done, job.tail = done.done, done.tail
            job.phase, job.result = (_Phase.OVER, done.whole) if done.whole is not None else (_Phase.LISTING, None)
        elif isinstance(done, LogWritten):
            job.done += len(job.block)
            job.block.clear()
            job.phase = _Phase.READING if job.done < job.log.size else _Phase.CHECKING
        else:
            job.phase, job.result = _Phase.OVER, done.whole
        return self._go_on(now_ms)

    # -- one step after the other ---------------------------------------------------------------------------

    def _go_on(self, now_ms: int) -> list[Output]:
        out: list[Output] = []
        if self._listing is not None and self._listing.is_over:
            self._listed, self._listed_ms, self._listing = self._listing, now_ms, None
            self._is_list_wanted = False
            out += self._on_listed(self._listed)
        if not self._vehicle.is_alive(now_ms):
            return out  # its heartbeats may return, and show it armed
        job = self._job
        is_quiet = now_ms < self._quiet_until_ms
        if job is not None:
            if job.phase is _Phase.WAITING and not is_quiet:
                job.phase, job.turn = _Phase.OPENING, next(self._turns)
                out.append(OpenLog(job.turn, job.log, job.done))
            reason = self._refusal(now_ms) if job.phase in _AT_AUTOPILOT else None
            if reason is not None:
                return out + self._end(reason)
            if job.window is not None:
                out += self._on_window(job, job.window, now_ms)
            if job.window is None and job.phase in (_Phase.PROVING, _Phase.READING) and now_ms >= job.next_ms:
                out += self._ask(job, now_ms)
        is_due = self._is_list_wanted or (job is not None and job.phase in (_Phase.LISTING, _Phase.CHECKING))
        if is_due and self._listing is None and not is_quiet:
            if job is not None and job.window is not None:
                out += self._break_off()  # one request at a time
            self._listing = Listing(self._vehicle.system_id)
            out += [Transmit(one) for one in self._listing.begin(now_ms)]
        return out

    def _on_listed(self, listed: Listing) -> list[Output]:
        """Go on if the log is in the list, the same or grown since; otherwise end its reading."""
        job = self._job
        if job is None or job.phase not in (_Phase.LISTING, _Phase.CHECKING):
            return []
        if listed.found is None:
            return self._end(listed.error or "")
        has_it = any(_is_of(one, job.log, listed.found) for one in listed.found)
        if job.phase is _Phase.CHECKING:
            if not has_it:
                return [*self._end("changed_meanwhile"), DropLog(job.log)]
            job.phase, job.turn = _Phase.FINISHING, next(self._turns)
            return [Transmit(end_message(self._vehicle.system_id)), FinishLog(job.turn, job.log)]
        if not has_it:
            return self._end("no_such_log")
        job.phase = _Phase.PROVING if job.tail else _Phase.READING
        return []

    def _ask(self, job: _Job, now_ms: int) -> list[Output]:
        """Request the next bytes: at most as many as the link has carried lately and the block has room for."""
        if job.phase is _Phase.PROVING:
            start, end = job.done - len(job.tail), job.done
        else:
            start = job.done + len(job.block)
            room = BLOCK_BYTES - len(job.block)
            end = min(job.log.size, start + min(room, self._messages * DATA_BYTES))
        job.window, job.window_ms = Window(self._vehicle.system_id, job.log, start, end), now_ms
        job.next_ms = now_ms + (end - start) * 1000 // MOST_BYTES_S
        return [Transmit(one) for one in job.window.ask(now_ms)]

    def _on_window(self, job: _Job, window: Window, now_ms: int) -> list[Output]:
        if window.error is not None:
            out = self._end(window.error)
            return [*out, DropLog(job.log)] if window.error == "changed_meanwhile" else out
        if not window.is_whole:
            return []
        job.window = None
        if job.phase is _Phase.PROVING:
            if window.data != job.tail:
                job.done = 0
            job.phase = _Phase.READING
            return []
        took_ms = max(1, now_ms - job.window_ms)
        carried = (window.end - window.start) * WINDOW_MS // (took_ms * DATA_BYTES)
        self._messages = max(LEAST_MESSAGES, min(MOST_MESSAGES, 2 * self._messages, carried))
        job.block += window.data
        if len(job.block) < BLOCK_BYTES and job.done + len(job.block) < job.log.size:
            return []
        job.phase, job.turn = _Phase.WRITING, next(self._turns)
        return [WriteLog(job.turn, job.log, job.done, bytes(job.block))]

    def _break_off(self) -> list[Output]:
        """Stop requesting. The reading later goes on from the bytes on the disk."""
        job = self._job
        is_asked = self._listing is not None
        self._listing = None
        if job is not None and job.phase in _AT_AUTOPILOT:
            is_asked = is_asked or job.phase is not _Phase.LISTING
            job.phase, job.turn, job.window = _Phase.WAITING, 0, None
            job.block.clear()
        return [Transmit(end_message(self._vehicle.system_id))] if is_asked else []

    def _end(self, reason: str) -> list[Output]:
        """End the reading of the log; its bytes on the disk stay."""
        assert self._job is not None
        out = self._break_off() if self._job.phase in _AT_AUTOPILOT else []
        self._job.phase, self._job.turn, self._job.result = _Phase.OVER, 0, reason
        return out

    def _refusal(self, now_ms: int) -> str | None:
        """Why no logs may be requested now; None if they may."""
        if self._vehicle.is_lost(now_ms):
            return "no_autopilot"
        return None if self._vehicle.seen(Armed) == Armed(False) else "armed"


def _is_of(listed: FlightLog, wanted: FlightLog, all_listed: tuple[FlightLog, ...]) -> bool:
    """Whether a listed log is the wanted one. Only the newest log grows, and only its time may be later."""
    if listed.number != wanted.number or listed.size < wanted.size:
        return False
    if listed.time_s == wanted.time_s:
        return True
    newest_s = max(one.time_s or 0 for one in all_listed)
    return wanted.time_s is not None and wanted.time_s < (listed.time_s or 0) == newest_s
