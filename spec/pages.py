"""The pages that a program of this package writes into."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path


def pages(files: Iterable[str], *data: str) -> list[Path]:
    """The pages by their paths; one line and exit code 2 if one is no file, or lacks `data` in the folder beside it."""
    found = [Path(file) for file in files]
    for page in found:
        for needed in (page, *(page.with_suffix("") / name for name in data)):
            if not needed.is_file():
                print(f"{needed}: no such file; expected the path of a page under docs", file=sys.stderr)
                sys.exit(2)
    return found
