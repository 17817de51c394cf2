"""The summary's tables in a Markdown document, between `<!-- summary:NAME -->` and `<!-- /summary -->`.

NAME is KIND:EXPERIMENT or KIND:EXPERIMENT:PROFILE, as numbers:scenario-1 or bytes:scenario-1:ideal.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...errors import UserError
from ...fly.results import write_text
from ...plan import wording
from ...plan.experiments import EXPERIMENTS
from ...plan.profiles.reading import profile_names
from . import claims, kinds, numbers, traffic
from .cells import Cell
from .overview import Overview, overviews

_MARKED = re.compile(r"(?P<begin><!-- summary:(?P<name>[^>]*?) -->\n)(?P<old>.*?)(?P<end><!-- /summary -->)", re.DOTALL)
_BEGIN = re.compile(r"<!-- summary:")
NOT_FLOWN = "Not flown."


def fill(document: Path, cells: Iterable[Cell]) -> list[str]:
    """Write each table anew between its markers; returns their names.

    Raises UserError for a document without markers, a marker that is not closed, and an unknown name.
    """
    try:
        text = document.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{document}: {getattr(error, 'strerror', None) or 'not UTF-8'}") from error
    known = overviews(cells, EXPERIMENTS)
    names: list[str] = []

    def replace(found: re.Match[str]) -> str:
        name = found["name"]
        if _BEGIN.search(found["old"]):
            raise UserError(f"{document}: summary:{name}: expected <!-- /summary --> before the next table")
        kind, overview = _named(document, name, known)
        reads = [] if any(before.startswith(f"{kind}:") for before in names) else [KINDS[kind].reading]
        names.append(name)
        written = "\n\n".join(part.strip() for part in (*KINDS[kind].write(overview), *reads) if part)
        return f"{found['begin']}\n{written}\n\n{found['end']}"

    filled = _MARKED.sub(replace, text)
    if len(names) != len(_BEGIN.findall(text)):
        raise UserError(f"{document}: expected <!-- /summary --> on a line after every <!-- summary:NAME -->")
    if not names:
        example = f"<!-- summary:numbers:{EXPERIMENTS[0]} --> and <!-- /summary -->"
        raise UserError(f"{document}: expected tables' markers in it, as {example}; tables: {', '.join(KINDS)}")
    if filled != text:
        write_text(document, filled)
    return names


def _named(document: Path, name: str, known: Sequence[Overview]) -> tuple[str, Overview]:
    """The kind of table that a marker names, and the overview it is made from. Raises UserError for an unknown name."""
    kind, _, of = name.partition(":")
    experiment, _, profile = of.partition(":")
    profiles = [*profile_names(), *(block.profile for one in known for block in one.blocks)]
    for value, expected in (
        (kind, list(KINDS)),
        (experiment, [one.experiment for one in known]),
        (profile or profiles[0], profiles),
    ):
        if value not in expected:
            names = ", ".join(dict.fromkeys(expected))
            raise UserError(f"{document}: summary:{name}: {value!r}: expected one of {names}")
    overview = next(one for one in known if one.experiment == experiment)
    return kind, overview.on(profile) if profile else overview


def numbers_of(overview: Overview) -> Iterator[str]:
    """A table per profile, and the profiles that were not flown."""
    for block in overview.blocks:
        yield f"**Profile `{block.profile}`**"
        flown = [row for row in block.rows if row.cell is not None]
        rows = [[f"`{row.arm}`", *(str(row.texts[name]) for name in numbers.COLUMNS)] for row in flown]
        yield _table(["arm", *numbers.COLUMNS.values()], rows)
    if overview.missing:
        yield f"Not flown on {wording.listed([f'`{name}`' for name in overview.missing])}."


def claims_of(overview: Overview) -> Iterator[str]:
    """Each claim of the thesis in each cell that was flown."""
    rows = [
        [f"`{block.profile}`", f"`{cell.arm}`", *map(str, judged)]
        for block in overview.blocks
        for cell, judged in block.judged
    ]
    headings = [claim.heading for claim in claims.claims()]
    yield _table(["profile", "arm", *headings], rows) if rows else NOT_FLOWN


def bytes_of(overview: Overview) -> Iterator[str]:
    """The bytes of both sides by purpose and layer, in a table per profile."""
    for block in overview.blocks:
        yield f"**Profile `{block.profile}`**"
        headings, rows = traffic.table([one for cell, _ in block.judged for one in traffic.bytes_of(cell)])
        yield _table(headings, [[f"`{arm}`", *rest] for arm, *rest in rows])
    if not overview.blocks:
        yield NOT_FLOWN


def kinds_of(overview: Overview) -> Iterator[str]:
    """The message set kind by kind, in a table per profile."""
    for block in overview.blocks:
        rows = [row for cell, _ in block.judged for row in kinds.rows_of(cell)]
        if rows:
            yield f"**Profile `{block.profile}`**"
            yield _table(kinds.HEADINGS, [[f"`{name}`", f"`{arm}`", *map(str, rest)] for name, arm, *rest in rows])
    if not overview.blocks:
        yield NOT_FLOWN


def series_of(overview: Overview) -> Iterator[str]:
    """The series behind the numbers, each with revision, machine, shaper, completion and notes; then the failures."""
    rows = []
    named = any(cell.machine for cell in overview.cells)
    for cell in overview.cells:
        told = [(cell.metrics["revision"] or "several")[:12], *([_plain(cell.machine)] if named else [])]
        told += [cell.metrics["shaper"], str(numbers.completed_of(cell))]
        rows.append([f"`{cell.name}`", *told, "; ".join(map(_plain, cell.metrics["notes"]))])
    headings = ["series", "revision", *(["machine"] if named else []), "shaper", "completed", ""]
    yield _table(headings, rows) if rows else NOT_FLOWN
    failed = [(f"{arm}-{block.profile}", said) for block in overview.blocks for arm, said in block.troubles]
    yield "".join(f"- {_plain(f'`{cell}`, {said}')}\n" for cell, said in failed)


@dataclass(frozen=True)
class TableKind:
    """A kind of table: its parts, and how to read it, which is written below the first such table in a document."""

    write: Callable[[Overview], Iterator[str]]
    reading: str = ""


KINDS = {
    "numbers": TableKind(numbers_of, numbers.READING),
    "claims": TableKind(claims_of, claims.READING),
    "bytes": TableKind(bytes_of, traffic.READING),
    "kinds": TableKind(kinds_of, kinds.READING),
    "series": TableKind(series_of),
}
"""The kinds by the first word of a marker's name; an experiment follows, and optionally a profile."""


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _plain(text: str) -> str:
    """Text with Markdown's special characters escaped, except backticks."""
    return re.sub(r"([*_<|])", r"\\\1", " ".join(text.split()))
