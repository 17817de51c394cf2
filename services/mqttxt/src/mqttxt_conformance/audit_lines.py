"""The lines of an audit log (section 14), read and checked without mqttxt's code."""

from __future__ import annotations

import asyncio
import json
from hashlib import sha256
from pathlib import Path
from typing import Any

from mqttxt.protocol.messages import CommandMessage

from .registry import NotTested, expect

_WRITTEN_S = 1.0
"""How long a record may take until it is in the file, 0.2 s by R14.7, on a machine that is busy."""
_BEFORE_THE_FIRST = "0" * 64
_HASH = ',"hash":"'
_FIRST_FIELDS = ["n", "time", "event"]


async def judged(
    path: Path | None, session: int, arm: CommandMessage, drone: int, who: str | None, signed: bool
) -> str:
    """Expect `command` and `word` once of `arm`, in the log of the process of `session`; returns the evidence.

    Raises NotTested without a file, and Broken.
    """
    if path is None:
        raise NotTested("needs {audit} in --run: the file of its audit log")
    await asyncio.sleep(_WRITTEN_S)
    lines = _lines(path)
    events = [line["event"] for line in lines]
    expect(events[:1] == ["file"], f"the first line is {events[:1]}, expected file")
    starts = [line for line in lines if line["event"] == "start" and line["session"] == session]
    expect(len(starts) == 1, f"{len(starts)} lines `start` of session {session}")
    for event, key, value in (("command", "command", "arm"), ("word", "word", "completed")):
        found = [line for line in lines if line["event"] == event and _is_about(line["said"], arm)]
        expect(len(found) == 1, f"arm, sent twice: {len(found)} lines `{event}`")
        (line,) = found
        told = (line["said"][key], line["drone"], line["signed"])
        expect(told == (value, drone, signed), f"line `{event}`: {told}, expected {(value, drone, signed)}")
        expect(event == "word" or line["who"] == who, f"line `{event}`: who is {line['who']}, expected {who}")
    return f"{len(lines)} lines, each with the hash of the one before; arm, sent twice: one `command`, one `word`"


def _is_about(said: dict[str, Any], command: CommandMessage) -> bool:
    return (said["gs_session"], said["seq"]) == (command.gs_session, command.seq)


def _lines(path: Path) -> list[dict[str, Any]]:
    """The lines of a log; raises Broken where one does not follow the one before."""
    expect(path.is_file(), f"{path.name}: no such file")
    found: list[dict[str, Any]] = []
    before = _BEFORE_THE_FIRST
    for text in path.read_bytes().decode("ascii", errors="replace").splitlines():
        expect(_HASH in text and text.endswith('"}'), f"a line without a hash at its end: {text[:80]}")
        body = text[: text.rindex(_HASH)] + "}"
        line = json.loads(text)
        number = found[-1]["n"] + 1 if found else line["n"]
        expect(list(line)[:3] == _FIRST_FIELDS, f"line {number} begins with {list(line)[:3]}")
        expect(json.dumps(line, separators=(",", ":")) == text, f"line {number}: blanks, or not ASCII")
        expect(line["n"] == number, f"line {line['n']} behind line {number - 1}")
        own = sha256((before + body).encode()).hexdigest()
        expect(line["hash"] == own, f"line {number}: hash {line['hash']}, expected {own}")
        before = line["hash"]
        found.append(line)
    return found
