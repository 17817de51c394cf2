"""The UAV client's journal: which commands were open, and which last words nobody has acknowledged yet.

One JSON object a line, synced before the command's first write to the autopilot. It keeps no command from
being executed (its session does that); it lets a restarted client say what became of the open ones.
"""

from __future__ import annotations

import json
import logging
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import ConfigurationError, PayloadError
from ..messages import CommandId, ResultMessage, Word
from ..roles.effects import Journal
from ..roles.uav_commands import Unfinished
from ..topics import FogSide
from ..wire.codec import encode

logger = logging.getLogger("mqttxt.journal")

MOST_DELIVERED = 500
"""Last words that are kept although they were delivered; far more than ten minutes of them."""
_LAST_WORDS = {word.label: word for word in Word if word.is_last}


class JournalFile:
    """Appends to `path`; `unfinished` is what the sessions before this one left.

    `is_new`: there was no journal, so nothing is known of them.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self.is_new = not path.exists()
            self.unfinished = _read(path)
            self._compact()
            self._file = path.open("a", encoding="ascii")
        except OSError as error:
            raise ConfigurationError(f"journal {path}: cannot be written: {error.strerror}") from error

    def record(self, effect: Journal) -> None:
        """Write one record and wait until it is on the disk."""
        self._file.write(_line(effect))
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()

    def _compact(self) -> None:
        """Start with what may still be asked for, so that the file does not grow over the sessions."""
        fresh = self._path.with_suffix(".new")
        lines = [_line(Journal(left.id, left.command, left.word, left.reason)) for left in self.unfinished]
        lines += [_line(Journal(left.id, left.command, done=True)) for left in self.unfinished if left.delivered]
        with fresh.open("w", encoding="ascii") as file:
            file.writelines(lines)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(self._path)


def _line(effect: Journal) -> str:
    record = {
        "gs_session": effect.id.gs_session,
        "seq": effect.id.seq,
        "command": effect.command,
        "word": effect.word.label if effect.word is not None else None,
        "reason": effect.reason,
        "done": effect.done,
    }
    return json.dumps(record) + "\n"


def _read(path: Path) -> list[Unfinished]:
    """The unfinished ids and the newest delivered ones; a line that a power loss cut off is left out and said."""
    if not path.exists():
        return []
    found: dict[CommandId, Unfinished] = {}
    for number, line in enumerate(path.read_text(encoding="ascii", errors="replace").splitlines(), start=1):
        try:
            left, done = _restored(json.loads(line))
        except (ValueError, KeyError, TypeError, RecursionError, PayloadError):
            logger.warning("journal %s: line %d cannot be read and is left out", path, number)
            continue
        if not done:
            found[left.id] = left
        elif left.id in found:
            found[left.id] = replace(found.pop(left.id), delivered=True)
    delivered = [left.id for left in found.values() if left.delivered]
    forgotten = set(delivered[:-MOST_DELIVERED])
    return [left for left in found.values() if left.id not in forgotten]


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
