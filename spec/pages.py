"""The files that the programs of this package read and write, by the paths that a user names."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

PAGE = "no such file; expected the path of a page under docs"
SERIES = "no such file; expected a series, a folder with metrics.json"


def pages(files: Iterable[str], *data: str) -> list[Path]:
    """The pages by their paths; one line and exit code 2 if one is no file, or lacks `data` in the folder beside it."""
    found = [Path(file) for file in files]
    for page in found:
        _all((page, *(page.with_suffix("") / name for name in data)), Path.is_file, PAGE)
    return found


def metrics_of(series: Iterable[str]) -> list[Path]:
    """The metrics of the series by their folders; one line and exit code 2 if one has none."""
    return _all((Path(folder) / "metrics.json" for folder in series), Path.is_file, SERIES)


def folders(paths: Iterable[str]) -> list[Path]:
    """The folders by their paths; one line and exit code 2 if one is none."""
    return _all(map(Path, paths), Path.is_dir, "no such folder")


def _all(paths: Iterable[Path], is_there: Callable[[Path], bool], otherwise: str) -> list[Path]:
    found = list(paths)
    for path in found:
        if not is_there(path):
            print(f"{path}: {otherwise}", file=sys.stderr)
            sys.exit(2)
    return found
