"""The summary's tables in a Markdown document, between `<!-- summary:NAME -->` and `<!-- /summary -->`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

from ..errors import UserError
from ..experiments import EXPERIMENTS
from ..report import words
from . import claims, numbers
from .cells import Cell
from .overview import Overview, overviews

_MARKED = re.compile(r"(?P<begin><!-- summary:(?P<name>[^>]*?) -->\n)(?P<old>.*?)(?P<end><!-- /summary -->)", re.DOTALL)
_BEGIN = re.compile(r"<!-- summary:")


def fill(document: Path, cells: Iterable[Cell]) -> list[str]:
    """Write each table anew between its markers; returns their names.

    Raises UserError for a document without markers, for one that is not closed, and for a name that is none.
    """
    try:
        text = document.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{document}: {getattr(error, 'strerror', None) or 'not UTF-8'}") from error
    known = tables(cells)
    names: list[str] = []

    def replace(found: re.Match[str]) -> str:
        name = found["name"]
        if name not in known:
            raise UserError(f"{document}: summary:{name}: expected one of {', '.join(known)}")
        if _BEGIN.search(found["old"]):
            raise UserError(f"{document}: summary:{name}: expected <!-- /summary --> before the next table")
        names.append(name)
        return f"{found['begin']}\n{known[name]().strip()}\n\n{found['end']}"

    filled = _MARKED.sub(replace, text)
    if len(names) != len(_BEGIN.findall(text)):
        raise UserError(f"{document}: expected <!-- /summary --> on a line after every <!-- summary:NAME -->")
    if not names:
        raise UserError(f"{document}: expected <!-- summary:NAME --> and <!-- /summary -->; NAME: {', '.join(known)}")
    if filled != text:
        document.write_text(filled, encoding="utf-8")
    return names


def tables(cells: Iterable[Cell]) -> dict[str, Callable[[], str]]:
    """What can stand between markers, by its name: for each experiment its numbers, the claims and the series."""
    found: dict[str, Callable[[], str]] = {}
    for one in overviews(cells, EXPERIMENTS):
        found[one.experiment] = partial(numbers_of, one)
        found[f"{one.experiment}-claims"] = partial(claims_of, one)
        found[f"{one.experiment}-series"] = partial(series_of, one)
    return found


def numbers_of(overview: Overview) -> str:
    """A table by profile, what went wrong below it, and on which profiles it was not flown."""
    parts = []
    for block in overview.blocks:
        rows = [[f"`{row.arm}`", *(row.texts[name] for name in numbers.COLUMNS)] for row in block.rows]
        parts += [f"**Profile `{block.profile}`**\n\n", _table(["arm", *numbers.COLUMNS.values()], rows)]
        parts += [f"{_plain(f'`{arm}`, {said}')}.\n\n" for arm, said in block.troubles]
    if overview.missing:
        profiles = words.listed([f"`{name}`" for name in overview.missing])
        parts.append(f"Not flown on {'any profile' if not overview.blocks else profiles}.\n\n")
    return "".join([*parts, f"{numbers.READING}\n" if overview.blocks else ""])


def claims_of(overview: Overview) -> str:
    """Each claim of the thesis in each cell that was flown."""
    rows = [
        [f"`{block.profile}`", f"`{cell.arm}`", *map(str, judged)]
        for block in overview.blocks
        for cell, judged in block.judged
    ]
    if not rows:
        return "Not flown.\n"
    headings = [claim.heading for claim in claims.claims()]
    return _table(["profile", "arm", *headings], rows) + claims.READING


def series_of(overview: Overview) -> str:
    """From which series the numbers are, of which revision, and what is to know of it."""
    rows = []
    for cell in overview.cells:
        revision = (cell.metrics["revision"] or "several")[:12]
        rows.append([f"`{cell.name}`", revision, cell.metrics["shaper"], "; ".join(map(_plain, cell.metrics["notes"]))])
    return _table(["series", "revision", "shaper", ""], rows) if rows else "Not flown.\n"


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines) + "\n"


def _plain(text: str) -> str:
    """Text that Markdown takes for nothing else, but for code."""
    return re.sub(r"([*_<|])", r"\\\1", " ".join(text.split()))
