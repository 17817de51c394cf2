"""The table of measured links: for each class and direction the worst link, with configured and measured figures.

`python -m testbed.fly.calibration.table results/links/latest/links.json docs/links-measured.md` puts the table of saved
checks, one file or more, between the page's markers.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ...plan.profiles.units import show_rate, show_share

HEAD = ("profile", "links", "delay ms", "jitter ms", "rate", "loss")
BEGIN, END = "<!-- measured: links -->", "<!-- end -->"
FIGURES = ("delay_ms", "jitter_ms", "rate_bps", "loss")


def rows_of(profile: str, links: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    """A row for each class and direction; each figure is that of the link that is furthest off in it."""
    groups: dict[str, list[str]] = {}
    for name in links:
        groups.setdefault(f"{name.partition(':')[0]} {name.rpartition(':')[2]}", []).append(name)
    for group, names in groups.items():
        yield (profile, group, *(_cell(figure, [links[name][figure] for name in names]) for figure in FIGURES))


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """The table in Markdown."""
    lines = [HEAD, ["---"] * len(HEAD), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def document_rows(document: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The rows of every profile in a saved check."""
    return [row for name, found in document["profiles"].items() for row in rows_of(name, found["links"])]


def write_into(page: Path, table: str) -> None:
    """Put the table between the page's markers. Raises ValueError unless the page has them once."""
    block = re.compile(f"{re.escape(BEGIN)}\n.*?{re.escape(END)}", re.DOTALL)
    text, found = block.subn(lambda _: f"{BEGIN}\n{table}\n{END}", page.read_text(encoding="utf-8"))
    if found != 1:
        raise ValueError(f"{page}: expected {BEGIN} and {END} once")
    page.write_text(text, encoding="utf-8")


def _cell(figure: str, found: Sequence[Mapping[str, Any]]) -> str:
    measured = [each for each in found if each["measured"] is not None and each.get("note") is None]
    if not measured:
        return "nothing" if any(each.get("highest") is not None for each in found) else "-"
    worst = max(measured, key=_distance)
    return f"{_shown(figure, worst['configured'])} → {_shown(figure, worst['measured'])}"


def _distance(found: Mapping[str, Any]) -> float:
    """The distance from the middle of the tolerated interval, in halves of its width."""
    low, high = found["lowest"], found["highest"]
    value = found["lost"] if "lost" in found else found["measured"]
    return float(abs(value - (low + high) / 2) / max(1e-9, (high - low) / 2))


def _shown(figure: str, value: float) -> str:
    if figure == "rate_bps":
        return show_rate(round(float(f"{value:.3g}")))
    if figure == "loss":
        return show_share(float(f"{value:.3g}"))
    return f"{value:.1f}"


if __name__ == "__main__":
    *saved, written = (Path(word) for word in sys.argv[1:])
    documents = [json.loads(path.read_text(encoding="utf-8")) for path in saved]
    write_into(written, markdown([row for document in documents for row in document_rows(document)]))
