"""Writes two tables into a page, each between its markers: the streams, and two recordings' facts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..errors import SitlError
from ..px4.streams import RATES_HZ
from .agreement import Fact, compare
from .apart import NOT_FLOWN, OF_ITSELF, reason
from .recording import Recording

STREAMS = ("<!-- streams: made by `python -m sitl compare --write` -->", "<!-- streams: end -->")
LIKENESS = {
    "px4": ("<!-- likeness: made by `python -m sitl compare --write` -->", "<!-- likeness: end -->"),
    "ardupilot": (
        "<!-- likeness to ArduCopter: made by `python -m sitl compare FILE --write` -->",
        "<!-- likeness to ArduCopter: end -->",
    ),
}
"""By family."""
ASKED_FOR = ("BATTERY_STATUS", "GLOBAL_POSITION_INT", "VFR_HUD")
"""What the ground station asks for at 1 Hz in five-states, beside the heartbeats."""
_IN_WORDS = ("acknowledgement", "armed", "mode", "landed_state")


def write(path: Path, first: Recording, second: Recording) -> None:
    """Put the tables where the last ones were. Raises SitlError for a page without markers."""
    try:
        text = path.read_text(encoding="utf-8")
        for (begin, end), table in ((STREAMS, streams()), (LIKENESS[first.like], likeness(first, second))):
            before, found, rest = text.partition(begin)
            _, ended, after = rest.partition(end)
            if not found or not ended:
                raise SitlError(f"{path}: expected {begin} and {end}")
            text = f"{before}{begin}\n\n{table}\n{end}{after}"
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


def likeness(first: Recording, second: Recording) -> str:
    """Markdown: what has a number is a row; what agrees in words, or in a message's rate and size, is counted."""
    facts = compare(first, second)
    lines = [f"| case | what | {first.autopilot} | {second.autopilot} |", "|---|---|---|---|"]
    for case in dict.fromkeys(fact.case for fact in facts):
        lines += _rows(case, [fact for fact in facts if fact.case == case])
    lines += ["", "What stays apart:", ""]
    for fact in facts:
        if not fact.agrees:
            why = reason(first.like, fact.case, fact.name) or "not explained"
            lines.append(f"- {fact.case}, {fact.name}: {fact.first} beside {fact.second}. {why}.")
    lines += [f"- {text}" for text in OF_ITSELF[first.like]]
    lines += ["", "Cases that do not apply:", ""]
    lines += [f"- {case}: {why}." for case, why in NOT_FLOWN[first.like].items()]
    return "\n".join([*lines, ""])


def _rows(case: str, facts: Sequence[Fact]) -> list[str]:
    counted = {
        "results and transitions": [fact for fact in facts if fact.name.startswith(_IN_WORDS)],
        "messages' rates and sizes": [fact for fact in facts if fact.name.endswith((", Hz", ", bytes"))],
        "parameters' defaults": [fact for fact in facts if fact.case == "parameters"],
    }
    rows = []
    for what, found in counted.items():
        agreeing = [fact for fact in found if fact.agrees]
        if agreeing:
            rows.append(f"| {case} | {what} | {len(found)} | {len(agreeing)} the same |")
    those = [fact for found in counted.values() for fact in found if fact.agrees]
    return rows + [f"| {case} | {fact.name} | {fact.first} | {fact.second} |" for fact in facts if fact not in those]
