"""Writes tables between a page's markers: the streams, two recordings' facts, and their lasting differences."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..errors import SitlError
from ..px4.streams import RATES_HZ
from .agreement import Fact, compare
from .apart import NOT_FLOWN, OF_ITSELF, reason
from .recording import Recording


def _marks(table: str, words: str = "compare") -> tuple[str, str]:
    """The markers around a table, which the command with these words makes."""
    return f"<!-- {table}: made by `python -m sitl {words} --write` -->", f"<!-- {table}: end -->"


STREAMS = _marks("streams")
LIKENESS = {"px4": _marks("likeness"), "ardupilot": _marks("likeness to ArduCopter", "compare FILE")}
APART = {"px4": _marks("apart"), "ardupilot": _marks("apart from ArduCopter", "compare FILE")}
"""By family."""
ASKED_FOR = ("BATTERY_STATUS", "GLOBAL_POSITION_INT", "VFR_HUD")
"""The messages that the ground station requests at 1 Hz in five-states, besides the heartbeats."""
_IN_WORDS = ("acknowledgement", "armed", "mode", "landed_state")


def write(path: Path, first: Recording, second: Recording) -> None:
    """Replace the tables between a page's markers. Raises SitlError for a page without markers."""
    try:
        text = path.read_text(encoding="utf-8")
        facts = compare(first, second)
        tables = (
            (STREAMS, streams()),
            (LIKENESS[first.like], likeness(first, second, facts)),
            (APART[first.like], apart(first.like, facts)),
        )
        held = [(marks, table) for marks, table in tables if marks[0] in text and marks[1] in text]
        if not held:
            raise SitlError(f"{path}: expected {' or '.join(' and '.join(marks) for marks, _ in tables)}")
        for (begin, end), table in held:
            before, _, rest = text.partition(begin)
            text = f"{before}{begin}\n\n{table}\n{end}{rest.partition(end)[2]}"
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SitlError(f"{path}: {error.strerror}") from error


def streams() -> str:
    """Markdown: each message's rate in each set; the total below."""
    lines = ["| message | px4-onboard | px4-normal | px4-gcs | five-states |", "|---|---|---|---|---|"]
    for name, rates in RATES_HZ.items():
        if any(rates):
            few = 1 if name in (*ASKED_FOR, "HEARTBEAT") else 0
            lines.append("| " + " | ".join([name, *(f"{hz:g}" if hz else "" for hz in (*rates, few))]) + " |")
    totals = [sum(rates[place] for rates in RATES_HZ.values()) for place in range(3)]
    lines.append("| together | " + " | ".join(f"{total:.0f}" for total in (*totals, 1 + len(ASKED_FOR))) + " |")
    return "\n".join([*lines, ""])


def likeness(first: Recording, second: Recording, facts: Sequence[Fact]) -> str:
    """Markdown: a row per case, a line in it per number; words, rates and sizes that agree are only counted."""
    lines = [f"| case | what | {first.autopilot} | {second.autopilot} |", "|---|---|---|---|"]
    for case in dict.fromkeys(fact.case for fact in facts):
        lines.append(_row(case, [fact for fact in facts if fact.case == case]))
    return "\n".join([*lines, ""])


def apart(like: str, facts: Sequence[Fact]) -> str:
    """Markdown: each difference with its reason, and the cases that are not flown."""
    lines = ["What stays apart:", ""]
    for fact in facts:
        if not fact.agrees:
            why = reason(like, fact.case, fact.name) or "not explained"
            lines.append(f"- {fact.case}, {fact.name}: {fact.first} beside {fact.second}. {why}.")
    lines += [f"- {text}" for text in OF_ITSELF[like]]
    lines += ["", "Cases that do not apply:", ""]
    lines += [f"- {case}: {why}." for case, why in NOT_FLOWN[like].items()]
    return "\n".join([*lines, ""])


def _row(case: str, facts: Sequence[Fact]) -> str:
    counted = {
        "results and transitions": [fact for fact in facts if fact.name.startswith(_IN_WORDS)],
        "messages' rates and sizes": [fact for fact in facts if fact.name.endswith((", Hz", ", bytes"))],
        "parameters' defaults": [fact for fact in facts if fact.case == "parameters"],
    }
    cells = []
    for what, found in counted.items():
        agreeing = [fact for fact in found if fact.agrees]
        if agreeing:
            cells.append((what, str(len(found)), f"{len(agreeing)} the same"))
    those = [fact for found in counted.values() for fact in found if fact.agrees]
    cells += [(fact.name, fact.first, fact.second) for fact in facts if fact not in those]
    return "| " + " | ".join([case, *("<br>".join(column) for column in zip(*cells, strict=True))]) + " |"
