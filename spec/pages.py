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
        for needed in (page, *(page.with_suffix("") / name for name in data)):
            _need(needed, Path.is_file, PAGE)
    return found


def metrics_of(series: Iterable[str]) -> list[Path]:
    """The metrics of the series by their folders; one line and exit code 2 if one has none."""
    found = [Path(folder) / "metrics.json" for folder in series]
    for path in found:
        _need(path, Path.is_file, SERIES)
    return found


def folders(paths: Iterable[str]) -> list[Path]:
    """The folders by their paths; one line and exit code 2 if one is none."""
    found = [Path(path) for path in paths]
    for path in found:
        _need(path, Path.is_dir, "no such folder")
    return found


def _need(path: Path, is_there: Callable[[Path], bool], otherwise: str) -> None:
    if not is_there(path):
        print(f"{path}: {otherwise}", file=sys.stderr)
        sys.exit(2)
