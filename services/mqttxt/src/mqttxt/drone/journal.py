"""The UAV client's journal: which commands were open, and which last words nobody has acknowledged yet.

One JSON object a line, synced before the command's first write to the autopilot. It keeps no command from
being executed (its session does that); it lets a restarted client say what became of the open ones.

What a failed write or sync left in the file is not known: part of a line may be there, and a later sync that
succeeds says nothing of what an earlier one lost. So the next record then writes the file anew.
"""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import ConfigurationError, PayloadError
from ..protocol.codec import encode
from ..protocol.messages import CommandId, ResultMessage, Word
from ..protocol.topics import FogSide
from .commands import Unfinished
from .disk import is_fault
from .effects import Journal

logger = logging.getLogger("mqttxt.journal")

MOST_DELIVERED = 500
"""Last words that are kept although they were delivered; far more than ten minutes of them."""
MOST_OUTDATED = 1000
"""Lines that later ones have made useless, beyond which the file is written anew."""
_GAP = b"one or more lines could not be read\n"
"""Stands for lines that were left out, and cannot be read either: a later session knows no more of them."""
_LAST_WORDS = {word.label: word for word in Word if word.is_last}


class JournalFile:
    """The journal at `path`. `is_new`: there was none that could be read as a whole, so that of an id of the sessions
    before that and is not in it, nothing is known.

    A disk that is full or fails does not end the client: `record` raises OSError until there is room again. Raises
    ConfigurationError for a path that no journal can have, and for the journal of another process: that one would go on
    writing to a file that this one has replaced.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._open: dict[CommandId, Unfinished] = {}
        self._delivered: dict[CommandId, Unfinished] = {}
        self._file: int | None = None
        self._lock: int | None = None
        self._lines = 0
        self._is_failing = False
        self._has_gap = False
        self.is_new = True
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._lock = _lock(path)
            if path.exists():
                self._has_gap = True  # until it was read
                self.is_new = self._has_gap = not self._read()
            self._write_anew()
        except OSError as error:
            if not is_fault(error):
                raise ConfigurationError(f"journal {path}: cannot be written: {error.strerror}") from error
            self._failed(error)

    @property
    def unfinished(self) -> list[Unfinished]:
        """What the sessions before this one left, and what this one added: the ids not delivered, then the others."""
        return [*self._open.values(), *self._delivered.values()]

    def record(self, effect: Journal) -> None:
        """Write one record and wait until it is on the disk; raises OSError, and an opening then never was."""
        self._take(Unfinished(effect.id, effect.command, effect.word, effect.reason), effect.done)
        try:
            if self._file is None:
                self._write_anew()
            else:
                self._append(effect)
        except OSError as error:
            if effect.is_opening:
                del self._open[effect.id]
            self._failed(error)
            raise
        if self._is_failing:
            self._is_failing = False
            logger.warning("journal %s: can be written again", self._path)
        if effect.done and self._lines > 2 * len(self._open) + len(self._delivered) + MOST_OUTDATED:
            self._make_smaller()

    def close(self) -> None:
        self._close_file()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _close_file(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _append(self, effect: Journal) -> None:
        assert self._file is not None
        _write(self._file, _line(effect))
        os.fsync(self._file)
        self._lines += 1

    def _failed(self, error: OSError) -> None:
        """What the file has now is not known; say so once, until a record is written."""
        if not self._is_failing:
            self._is_failing = True
            what = error.strerror or error
            logger.error("journal %s: %s; commands are denied until it can be written", self._path, what)
        self._close_file()

    def _make_smaller(self) -> None:
        """Leave out what later lines made useless; where that fails, the file stays, or is written anew next time."""
        try:
            self._write_anew()
        except OSError as error:
            logger.debug("journal %s: not made smaller: %s", self._path, error)
            self._lines = 0

    def _write_anew(self) -> None:
        """Replace the file by one with what may still be asked for; at any moment one of the two is whole."""
        fresh = self._path.with_name(f"{self._path.name}.new")
        lines = [_GAP] if self._has_gap else []
        lines += [_line(Journal(left.id, left.command, left.word, left.reason)) for left in self._open.values()]
        lines += [
            _line(Journal(left.id, left.command, left.word, left.reason, True)) for left in self._delivered.values()
        ]
        file = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_CLOEXEC, 0o644)
        try:
            _write(file, b"".join(lines))
            os.fsync(file)
            self._close_file()  # from here on the path may lead to either
            fresh.replace(self._path)
            _sync_folder(self._path.parent)
        except OSError:
            os.close(file)
            raise
        self._file, self._lines = file, len(lines)

    def _take(self, left: Unfinished, done: bool) -> None:
        """What a record changes. An id that is done stays known without its word too: it was started."""
        known = self._open.pop(left.id, None) or self._delivered.pop(left.id, None)
        if not done:
            self._open[left.id] = left
            return
        said = known if known is not None and left.word is None else left
        self._delivered[left.id] = replace(said, delivered=True)
        while len(self._delivered) > MOST_DELIVERED:
            del self._delivered[next(iter(self._delivered))]

    def _read(self) -> bool:
        """Whether nothing is missing. A line that cannot be read is left out and logged.

        Nothing is missing where that is the last one and has no end: it was being written when the power went, and what
        it says was not begun.
        """
        is_whole = True
        lines = self._path.read_text(encoding="ascii", errors="replace").split("\n")
        for number, line in enumerate(lines, start=1):
            if not line:
                continue
            try:
                left, done = _restored(json.loads(line))
            except (ValueError, KeyError, TypeError, RecursionError, PayloadError):
                logger.warning("journal %s: line %d cannot be read and is left out", self._path, number)
                is_whole = is_whole and number == len(lines)
                continue
            self._take(left, done)
        return is_whole


def _lock(path: Path) -> int | None:
    """Keep a journal from other processes for as long as the result is open; None where the disk has no lock to give.

    Raises ConfigurationError where another one has it. The lock is a file of its own: the journal's is replaced.
    """
    try:
        file = os.open(path.with_name(f"{path.name}.lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError:  # as of a full disk; whatever else is wrong with the path shows at the journal's own file
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        if error.errno != errno.EWOULDBLOCK:
            return None
        raise ConfigurationError(f"journal {path}: another process has it; expected one for each UAV client") from None
    return file


def _write(file: int, data: bytes) -> None:
    """All of it; what a full disk took only a part of fails at the next part."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(file, rest) :]


def _sync_folder(folder: Path) -> None:
    """Make a renaming last over a power loss, where the file system can be asked to."""
    file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(file)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(file)


def _line(effect: Journal) -> bytes:
    record = {
        "gs_session": effect.id.gs_session,
        "seq": effect.id.seq,
        "command": effect.command,
        "word": effect.word.label if effect.word is not None else None,
        "reason": effect.reason,
        "done": effect.done,
    }
    return json.dumps(record).encode("ascii") + b"\n"


def _restored(record: Any) -> tuple[Unfinished, bool]:
    """One record, and whether it is done; raises one of several errors for what `_line` would not have written."""
    command_id = CommandId(record["gs_session"], record["seq"])
    word = _LAST_WORDS[record["word"]] if record["word"] is not None else None
    left = Unfinished(command_id, record["command"], word, record["reason"])
    spoken = word or Word.UNCONFIRMED
    encode(ResultMessage(gs_session=left.id.gs_session, seq=left.id.seq, session=1, stamp=0, word=spoken))
    FogSide().parse(FogSide().commands_result(1, left.command))
    if not isinstance(left.reason, str | None) or not isinstance(record["done"], bool):
        raise ValueError("reason or done")
    return left, record["done"]
