"""Runs `ip` and `tc`: one command, or many in one process, which takes a tenth of the time."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from typing import Any

from ..interfaces import NetError

Words = Sequence[str]
Runner = Callable[[Words, str | None], "Done"]
"""Runs a command with a text as input."""
_PLACE = re.compile(r"Command failed -:(\d+)")


class Done:
    """A command's exit code and its output."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, " ".join(err.split())


def run(words: Words, text: str | None = None) -> Done:
    """Run a real command."""
    try:
        ended = subprocess.run(list(words), input=text, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return Done(127, "", f"{words[0]}: not found")
    return Done(ended.returncode, ended.stdout, ended.stderr)


def carry_out(commands: Sequence[Words], runner: Runner, where: str) -> list[Any]:
    """Run commands in order; returns the output of those that show something. Raises NetError that begins with `where`
    and names the command that failed."""
    shown: list[Any] = []
    place = 0
    for program, group in groupby(commands, key=lambda words: words[0]):
        lines = [" ".join(words[1:]) for words in group]
        done = runner([program, "-s", "-j", "-batch", "-"], "".join(f"{line}\n" for line in lines))
        if done.code:
            found = _PLACE.search(done.err)
            at = int(found[1]) - 1 if found else 0
            said = _PLACE.sub("", done.err).strip() or f"exit code {done.code}"
            raise NetError(f"{where}[{place + at}]: {program} {lines[at]}: {said}")
        shown += documents(done.out)
        place += len(lines)
    return shown


def documents(text: str) -> Iterator[Any]:
    """The JSON values in a text, one after the other."""
    decoder, at = json.JSONDecoder(), 0
    while at < len(text):
        if text[at].isspace():
            at += 1
            continue
        value, at = decoder.raw_decode(text, at)
        yield value
