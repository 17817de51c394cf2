"""Writes the table of two recordings' facts into a page, between its markers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..errors import SitlError
from .agreement import Fact, compare
from .recording import Recording

BEGIN, END = "<!-- likeness: made by `python -m sitl compare` -->", "<!-- likeness: end -->"
_IN_WORDS = ("acknowledgement", "armed", "mode", "landed_state")


def write(path: Path, first: Recording, second: Recording) -> None:
    """Put the table where the last one was. Raises SitlError for a page without markers."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SitlError(f"{path}: {error.strerror}") from error
    before, found, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not found or not ended:
        raise SitlError(f"{path}: expected {BEGIN} and {END}")
    path.write_text(f"{before}{BEGIN}\n\n{table(first, second)}\n{END}{after}", encoding="utf-8")


def table(first: Recording, second: Recording) -> str:
    """Markdown: what has a number a row; what agrees in words counts as one row a case."""
    facts = compare(first, second)
    lines = [f"| case | what | {first.autopilot} | {second.autopilot} | |", "|---|---|---|---|---|"]
    for case in dict.fromkeys(fact.case for fact in facts):
        lines += _rows(case, [fact for fact in facts if fact.case == case])
    return "\n".join([*lines, ""])


def _rows(case: str, facts: Sequence[Fact]) -> list[str]:
    """The facts in words that agree are counted; those that differ and all with numbers are rows of their own."""
    words = [fact for fact in facts if fact.name.startswith(_IN_WORDS)]
    same = [fact for fact in words if fact.agrees]
    rows = [f"| {case} | results and transitions | {len(same)} | the same | |"] if same else []
    for fact in [*(fact for fact in words if not fact.agrees), *(fact for fact in facts if fact not in words)]:
        mark = "" if fact.agrees else "differs"
        rows.append(f"| {case} | {fact.name} | {fact.first} | {fact.second} | {mark} |")
    return rows
