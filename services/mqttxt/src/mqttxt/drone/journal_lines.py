"""The lines of the UAV client's journal: how each is written and read, and whether a file has any."""

from __future__ import annotations

import json
from typing import Any

from ..errors import PayloadError
from ..protocol.codec import encode
from ..protocol.messages import CommandId, ResultMessage, Word
from ..protocol.topics import FogSide
from .answers import Unfinished
from .effects import Journal

GAP = "gap_s"
"""The only field of the line that gives a gap's age."""
FRONT = "front"
"""The only field of the line that names the front, which may have records that this journal lacks."""
FORGOTTEN = "forgotten"
"""The only field of a line with a station's session and its highest `seq` that the journal has dropped."""
_BEGINNINGS = tuple(f'{{"{name}": ' for name in (GAP, FRONT, "gs_session"))
"""How a journal begins; with a gap's age, unless an earlier version wrote it."""
_LAST_WORDS = {word.label: word for word in Word if word.is_last}


def line_of(effect: Journal) -> bytes:
    """A record as a line of the journal."""
    record = {
        "gs_session": effect.id.gs_session,
        "seq": effect.id.seq,
        "command": effect.command,
        "word": effect.word.label if effect.word is not None else None,
        "reason": effect.reason,
        "done": effect.done,
    }
    return _line(record)


def gap_line(age_s: float) -> bytes:
    """The line with a gap's age."""
    return _line({GAP: int(age_s)})


def front_line(name: str) -> bytes:
    """The line with the front's name."""
    return _line({FRONT: name})


def forgotten_line(command_id: CommandId) -> bytes:
    """The line with the highest id of a station's session that was dropped."""
    return _line({FORGOTTEN: command_id})


def _line(plain: dict[str, Any]) -> bytes:
    return json.dumps(plain).encode("ascii") + b"\n"


def parsed(line: str) -> int | str | CommandId | tuple[Unfinished, bool]:
    """What a line says: a gap's age in seconds, a front's name, a dropped id, or a record and whether it is done.

    Raises ValueError for a line that no journal has.
    """
    try:
        plain = json.loads(line)
        if list(plain) == [GAP]:
            return _age_s(plain[GAP])
        if list(plain) == [FRONT] and isinstance(front := plain[FRONT], str):
            return front
        if list(plain) == [FORGOTTEN]:
            return _checked(CommandId(*plain[FORGOTTEN]))
        return _restored(plain)
    except (KeyError, TypeError, RecursionError, PayloadError) as error:
        raise ValueError(f"no line of a journal: {error!r}") from error


def is_journal(text: str) -> bool:
    """Whether a text is a journal, however damaged: it begins like one, or has a line of one.

    So may an empty one be, and one of zeros: a power loss can leave both.
    """
    text = text.strip("\0")
    begins_like_one = any(begins.startswith(text[: len(begins)]) for begins in _BEGINNINGS)
    return begins_like_one or any(map(_is_readable, text.split("\n")))


def _is_readable(line: str) -> bool:
    try:
        parsed(line)
    except ValueError:
        return False
    return True


def _age_s(plain: Any) -> int:
    if type(plain) is not int or plain < 0:
        raise ValueError(f"{GAP} {plain!r}")
    return plain


def _restored(record: Any) -> tuple[Unfinished, bool]:
    """One record, and whether it is done. Raises one of several errors for one that `line_of` does not write."""
    command_id = _checked(CommandId(record["gs_session"], record["seq"]))
    word = _LAST_WORDS[record["word"]] if record["word"] is not None else None
    left = Unfinished(command_id, record["command"], word, record["reason"])
    FogSide().parse(FogSide().commands_result(1, left.command))
    if not isinstance(left.reason, str | None) or not isinstance(record["done"], bool):
        raise ValueError("reason or done")
    return left, record["done"]


def _checked(command_id: CommandId) -> CommandId:
    """The id. Raises PayloadError for one that no message can have."""
    gs_session, seq = command_id
    encode(ResultMessage(gs_session=gs_session, seq=seq, session=1, stamp=0, word=Word.UNCONFIRMED))
    return command_id
