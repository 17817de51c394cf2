"""The UAV client's journal: which commands were open, and their last words, delivered or not.

One JSON object per line, which the front or the disk has before the command's first write to the autopilot. It prevents
no second execution (the session does); it lets a restarted client report the outcome of open commands.

After a failed write or sync the file's contents are unknown: part of a line may be there, and a later sync that
succeeds does not show what an earlier one lost. So the next record writes the file anew.

The first line has the age of the newest gap, so that a whole journal is never empty: an empty file lost its records.
"""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..core.disk import is_fault, sync_folder, write_all
from ..core.forgotten import Forgotten
from ..errors import ConfigurationError
from ..protocol.messages import CommandId
from ..security.files import replaceable
from . import journal_front
from .answers import Unfinished
from .effects import Journal
from .journal_front import Front
from .journal_lines import forgotten_line, front_line, gap_line, is_journal, line_of, parsed

logger = logging.getLogger("mqttxt.journal")

MOST_DELIVERED = 500
"""The number of delivered last words that are kept; far more than ten minutes of them."""
MOST_FORGOTTEN = 1000
"""The number of stations' sessions whose dropped words are remembered."""
MOST_OUTDATED = 1000
"""The number of outdated lines above which the file is written anew."""
ASKED_FOR_S = 25 * 3600
"""Longer than an id can be queried: a minute until its deadline, a day's limit, ten minutes in ledgers."""
GAP_NOTED_S = 60
"""How much a gap has to age before its age is written again, with the next record."""


class JournalFile:
    """The journal at `path`. `has_gap`: the outcome of an id that is not in it is unknown, because the journal of the
    earlier sessions was missing or could not be read as a whole.

    A gap ends when clients have run for longer than an id can be queried: `clock_s` counts that, from record to
    record. A disk that is full or fails does not end the client: `record` raises OSError until a write succeeds again.
    Raises ConfigurationError for a path that no journal can have, for a file that is no journal, and for the journal of
    another running process: that one would go on writing to a file that this one has replaced. At a symbolic link the
    journal is where the link leads.

    `with_front`: use a front, which may have records before the disk does, if the disk takes its name.
    """

    def __init__(self, path: Path, clock_s: Callable[[], float] = time.monotonic, *, with_front: bool = False) -> None:
        self._path = path
        self._clock_s = clock_s
        self.front = Front.create() if with_front else None
        self._left_front: str | None = None
        """The front of an earlier client that did not end cleanly."""
        self._began_s = clock_s()
        self._gap_s: float | None = 0.0
        """How long clients had run since the gap when this one began, s; None without a gap."""
        self._noted_s = 0.0
        self._open: dict[CommandId, Unfinished] = {}
        self._delivered: dict[CommandId, Unfinished] = {}
        self._forgotten = Forgotten(MOST_FORGOTTEN)
        self._file: int | None = None
        self._lock: int | None = None
        self._lines = 0
        self._is_failing = False
        try:
            self._path = replaceable(path)
            if not self._may_be_journal():
                raise ConfigurationError(
                    f"--journal {path}: no line of a journal in it; expected a journal, or no file"
                )
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._lock = _lock(self._path)
            if self._path.exists():
                self._read()
            self._write_anew()
        except OSError as error:
            self._drop_front()
            if not is_fault(error):
                raise ConfigurationError(
                    f"--journal {path}: cannot be written: {error.strerror}; expected a file"
                ) from error
            self._failed(error)
        except ConfigurationError:
            self._drop_front()
            raise

    @property
    def has_gap(self) -> bool:
        return self._gap_s is not None

    @property
    def unfinished(self) -> list[Unfinished]:
        """All records, also of earlier sessions: first the ids without a delivered last word."""
        return [*self._open.values(), *self._delivered.values()]

    @property
    def forgotten(self) -> list[CommandId]:
        """The highest dropped id of each station's session: it and lower ones may have been in the journal."""
        return list(self._forgotten)

    def record(self, effect: Journal, is_begun: bool = False) -> None:
        """Write one record and wait until it is on the disk. Raises OSError, and then forgets an opening.

        An opening that `is_begun` is in the front. It is not forgotten, and the disk takes it with a later record.
        """
        self._take(Unfinished(effect.id, effect.command, effect.word, effect.reason), effect.done)
        try:
            if self._file is None:
                self._write_anew()
            else:
                self._append(effect)
        except OSError as error:
            if effect.is_opening and not is_begun:
                del self._open[effect.id]
            self._failed(error)
            raise
        if self._is_failing:
            self._is_failing = False
            logger.warning("journal %s: can be written again", self._path)
        kept = 2 * len(self._open) + len(self._delivered) + len(self._forgotten)
        if effect.done and self._lines > kept + MOST_OUTDATED:
            self._make_smaller()

    def close(self) -> None:
        """Close the journal. It no longer names the front, unless the disk failed to take the front's records."""
        if self.front is not None:
            self._end_front()
        self._close_file()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _close_file(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _end_front(self) -> None:
        front, self.front = self.front, None
        assert front is not None
        self._left_front = front.name
        try:
            self._write_anew()
        except OSError as error:
            self._failed(error)
        front.close()

    def _drop_front(self) -> None:
        """Go on without a front, because the disk does not have its name."""
        if self.front is not None:
            self.front.close()
            journal_front.remove(self.front.name)
            self.front = None

    def _append(self, effect: Journal) -> None:
        assert self._file is not None
        lines = [line_of(effect), *self._gap_lines(GAP_NOTED_S)]
        write_all(self._file, b"".join(lines))
        os.fsync(self._file)
        self._lines += len(lines)

    def _gap_lines(self, older_s: float) -> list[bytes]:
        """A line with the gap's age, if a gap has aged `older_s` since the last such line."""
        if self._gap_s is None:
            return []
        age_s = self._gap_s + self._clock_s() - self._began_s
        if age_s < self._noted_s + older_s:
            return []
        self._noted_s = age_s
        return [gap_line(age_s)]

    def _failed(self, error: OSError) -> None:
        """Close the file, whose contents are now unknown; log the first failure after a success."""
        if not self._is_failing:
            self._is_failing = True
            what = error.strerror or error
            denied = "commands" if self.front is None else "commands other than hold, land and return"
            logger.error("journal %s: %s; %s are denied until it can be written", self._path, what, denied)
        self._close_file()

    def _make_smaller(self) -> None:
        """Drop outdated lines. If that fails, the file stays as it is, or the next record writes it anew."""
        try:
            self._write_anew()
        except OSError as error:
            logger.debug("journal %s: not made smaller: %s", self._path, error)
            self._lines = 0

    def _write_anew(self) -> None:
        """Replace the file by one with the records that may still be queried; one of the two is whole at any time."""
        fresh = self._path.with_name(f"{self._path.name}.new")
        lines = self._gap_lines(0) if self._gap_s is not None else [gap_line(ASKED_FOR_S)]
        if self.front is not None:
            lines.append(front_line(self.front.name))
        lines += map(forgotten_line, self._forgotten)
        lines += [line_of(Journal(left.id, left.command, left.word, left.reason)) for left in self._open.values()]
        lines += [
            line_of(Journal(left.id, left.command, left.word, left.reason, True)) for left in self._delivered.values()
        ]
        file = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_CLOEXEC, 0o644)
        try:
            write_all(file, b"".join(lines))
            os.fsync(file)
            self._close_file()  # from here on the path may lead to either
            fresh.replace(self._path)
            sync_folder(self._path.parent)
        except OSError:
            os.close(file)
            raise
        self._file, self._lines = file, len(lines)
        if self._left_front is not None:
            journal_front.remove(self._left_front)
            self._left_front = None

    def _take(self, left: Unfinished, done: bool) -> None:
        """Take a record in. An id that is done stays known even without its word: it was started.

        An opening of a known id is the front's copy of a record on the disk, and changes nothing.
        """
        known = self._open.pop(left.id, None) or self._delivered.pop(left.id, None)
        if known is not None and not done and left.word is None:
            left, done = known, known.delivered
        if not done:
            self._open[left.id] = left
            return
        said = known if known is not None and left.word is None else left
        self._delivered[left.id] = replace(said, delivered=True)
        while len(self._delivered) > MOST_DELIVERED:
            self._forget(next(iter(self._delivered)))

    def _forget(self, command_id: CommandId) -> None:
        """Remember a dropped id, and drop its record. A session that has to make room for it is a gap."""
        self._delivered.pop(command_id, None)
        if self._forgotten.note(command_id):
            self._gap_s, self._began_s, self._noted_s = 0.0, self._clock_s(), 0.0

    def _may_be_journal(self) -> bool:
        """Whether a journal may replace the file. What a disk does not give is not judged."""
        try:
            return is_journal(self._text())
        except OSError:
            return True

    def _text(self) -> str:
        return self._path.read_text(encoding="ascii", errors="replace")

    def _read(self) -> None:
        """Read the records and the age of the gap. Without a readable line the records may be lost."""
        text = self._text()
        self._gap_s = ASKED_FOR_S  # no gap, unless a line names one or has no place
        is_readable = self._read_lines(text) and self._lines > 0
        if self._left_front is not None:
            found = journal_front.read(self._left_front)
            is_readable = is_readable and found is not None and self._read_lines(found)
        if not is_readable:
            self._gap_s = 0.0
        elif self._gap_s >= ASKED_FOR_S:
            self._gap_s = None

    def _read_lines(self, text: str) -> bool:
        """Whether all of the text is readable. Unreadable lines are left out.

        An unreadable last line without an end is no gap: it was being written when the power failed, and its command
        was not begun.
        """
        is_readable = True
        lines = text.split("\n")
        for number, line in enumerate(lines, start=1):
            if not line:
                continue
            try:
                match parsed(line):
                    case int() as age_s:
                        self._gap_s = age_s
                    case str() as front:
                        self._left_front = front
                    case CommandId() as dropped:
                        self._forget(dropped)
                    case left, done:
                        self._take(left, done)
                self._lines += 1
            except ValueError:
                logger.warning("journal %s: line %d cannot be read and is left out", self._path, number)
                is_readable = is_readable and number == len(lines)
        return is_readable


def _lock(path: Path) -> int | None:
    """Lock a journal for as long as the returned file descriptor is open; None if the file system gives no lock.

    Raises ConfigurationError if another process has it. The lock is a separate file, because the journal's is replaced.
    """
    try:
        file = os.open(path.with_name(f"{path.name}.lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError:  # as on a full disk; any other fault of the path shows at the journal's own file
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        if error.errno != errno.EWOULDBLOCK:
            return None
        raise ConfigurationError(
            f"--journal {path}: another process has it; expected one for each UAV client"
        ) from None
    return file
