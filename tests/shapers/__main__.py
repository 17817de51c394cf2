"""Runs the comparison of both shapers and writes its table into a page: `python -m tests.shapers FILE`."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spec.tables import table

from .comparison import Row, compare
from .machine import Machine
from .rounds import Round, job, rounds

BEGIN, END = "<!-- measured: shapers -->", "<!-- end -->"


def main(page: Path) -> int:
    chosen = rounds()
    with tempfile.TemporaryDirectory() as folder:
        machines = [Machine(Path(folder) / shaper, job(shaper, chosen)) for shaper in ("netem", "nfqueue")]
        kernel, emulator = (machine.result() for machine in machines)
    return write(page, chosen, kernel, emulator)


def write(page: Path, chosen: list[Round], kernel: Mapping[str, Any], emulator: Mapping[str, Any]) -> int:
    """Write the table into a page; returns the exit code, 1 if a row does not agree."""
    rows = [row for found in compare(chosen, kernel, emulator).values() for row in found]
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    about = f"Linux {kernel['kernel']}, {kernel['tc'].split(',')[1].strip()}:"
    page.write_text(f"{before}{BEGIN}\n{about}\n\n{table_of(rows)}\n{END}{after}", encoding="utf-8")
    apart = [row for row in rows if not row.agrees]
    print(f"{page}: {len(rows)} rows, {len(apart)} apart", *apart, sep="\n")
    return bool(apart)


def table_of(rows: list[Row]) -> str:
    """The table in Markdown; a feature is named in the first of its rows."""
    cells, last = [], ""
    for row in rows:
        feature, last = ("" if row.feature == last else row.feature), row.feature
        numbers = (f"{float(f'{number:.2g}'):g} {row.unit}".strip() for number in (row.difference, row.tolerance))
        cells.append((feature, row.statistic, row.kernel, row.emulator, *numbers))
    return table(("link", "statistic", "kernel", "emulator", "apart", "tolerance"), cells)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
