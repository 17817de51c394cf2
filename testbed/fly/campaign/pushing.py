"""Moves a series from the machine that flew it into the campaign's results folder, completely or not at all."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Protocol

from ...errors import ResultsError
from ..results import Series, point_latest

CHUNK = 4 * 2**20
INCOMING = ".incoming"
"""The folder within a results folder for series that are not complete yet."""


@dataclass(frozen=True)
class ArrivedSeries:
    """A complete series in the campaign's results folder.

    `series` is its path below that folder, `troubles` has a line for each number that was given up.
    """

    series: str
    machine: str
    files: int
    size: int
    troubles: tuple[str, ...] = ()


@dataclass(frozen=True)
class File:
    """A file of a series: its path below the series' folder, its length, and its SHA-256."""

    path: str
    size: int
    sha256: str


def files_of(folder: Path) -> tuple[File, ...]:
    """Every regular file below a folder, sorted by path."""
    found = sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return tuple(File(path.relative_to(folder).as_posix(), path.stat().st_size, _sha256(path)) for path in found)


class Receiver(Protocol):
    """A `Store` as the sender of a series sees it."""

    def there(self, name: str) -> ArrivedSeries | None: ...
    def begin(self, series: str, files: tuple[File, ...]) -> str: ...
    def put(self, token: str, path: str, offset: int, data: bytes) -> None: ...
    def finish(self, token: str, name: str, machine: str, troubles: tuple[str, ...]) -> ArrivedSeries: ...


class Store:
    """Takes series into a results folder. Each campaign has its own; it removes what an interrupted one left behind.

    `name` identifies a series of the campaign: the first complete one counts, later ones are dropped. So a machine
    that was given up and returns with a series that was flown elsewhere meanwhile adds nothing.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._there: dict[str, ArrivedSeries] = {}
        self._announced: dict[str, tuple[str, dict[str, File]]] = {}
        self._begun = 0
        shutil.rmtree(root / INCOMING, ignore_errors=True)

    def there(self, name: str) -> ArrivedSeries | None:
        """The series that has arrived under a name, if any."""
        return self._there.get(name)

    def begin(self, series: str, files: tuple[File, ...]) -> str:
        """Announce a series' files; returns the token for the calls that follow. Raises ResultsError for a bad path."""
        if not _is_a_series(series):
            raise ResultsError(f"pushed: {series!r}: expected EXPERIMENT/ARM-PROFILE/TIME")
        wrong = [file.path for file in files if not _is_below(file.path)]
        if wrong:
            raise ResultsError(f"pushed: {wrong[0]!r}: expected a path below the series' folder")
        self._begun += 1
        token = str(self._begun)
        (self._root / INCOMING / token).mkdir(parents=True)
        self._announced[token] = series, {file.path: file for file in files}
        return token

    def put(self, token: str, path: str, offset: int, data: bytes) -> None:
        """Write a part of a file; repeating a part is harmless. Raises ResultsError for one that was not announced."""
        file = self._announced[token][1].get(path)
        if file is None or offset + len(data) > file.size:
            raise ResultsError(f"pushed: {path}, {offset} to {offset + len(data)}: not in what was announced")
        target = self._root / INCOMING / token / path
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("r+b" if target.exists() else "wb") as out:
            out.seek(offset)
            out.write(data)

    def finish(self, token: str, name: str, machine: str, troubles: tuple[str, ...]) -> ArrivedSeries:
        """Put the series into its place if every file is as announced; returns the series that arrived under the name.

        Raises ResultsError for the first file that is not as announced; the series is then dropped.
        """
        staged = self._root / INCOMING / token
        series, files = self._announced.pop(token)
        try:
            if name not in self._there:
                _check(staged, files)
                placed = _put_in_place(staged, self._root / series)
                point_latest(placed)
                size = sum(file.size for file in files.values())
                path = placed.path.relative_to(self._root).as_posix()
                self._there[name] = ArrivedSeries(path, machine, len(files), size, troubles)
        finally:
            shutil.rmtree(staged, ignore_errors=True)
        return self._there[name]


def push(
    series: Series, root: Path, name: str, machine: str, troubles: Sequence[str], store: Receiver
) -> ArrivedSeries:
    """Push a series that is below `root`; returns the one that arrived under the name, from this machine or another."""
    files = files_of(series.path)
    token = store.begin(series.path.relative_to(root).as_posix(), files)
    for file in files:
        for offset, data in _chunks(series.path / file.path):
            store.put(token, file.path, offset, data)
    return store.finish(token, name, machine, tuple(troubles))


def remove(series: Series, root: Path) -> None:
    """Remove a series that was pushed; it is first moved to where no run resumes it."""
    gone = root / ".pushed"
    gone.mkdir(exist_ok=True)
    series.path.rename(gone / series.path.name)
    shutil.rmtree(gone, ignore_errors=True)


def _put_in_place(staged: Path, target: Path) -> Series:
    """Move a series to its name, with a suffix if another machine's began in the same second."""
    target.parent.mkdir(parents=True, exist_ok=True)
    for suffix in ("", *(f"-{n}" for n in range(2, 100))):
        path = target.with_name(f"{target.name}{suffix}")
        if not path.exists():
            staged.rename(path)
            return Series(path)
    raise ResultsError(f"{target}: 99 series began in the same second")


def _check(staged: Path, expected: Mapping[str, File]) -> None:
    """Raise ResultsError for the first file that is not as announced; flush the others to disk."""
    for path, file in expected.items():
        target = staged / path
        if file.size == 0:  # of an empty file no part was sent
            target.parent.mkdir(parents=True, exist_ok=True)
            target.touch()
        if not target.is_file() or target.stat().st_size != file.size or _sha256(target) != file.sha256:
            raise ResultsError(f"pushed: {path}: not whole: expected {file.size} bytes, SHA-256 {file.sha256[:12]}…")
        with target.open("rb") as written:
            os.fsync(written.fileno())


def _chunks(path: Path) -> Iterator[tuple[int, bytes]]:
    offset = 0
    with path.open("rb") as source:
        while data := source.read(CHUNK):
            yield offset, data
            offset += len(data)


def _sha256(path: Path) -> str:
    with path.open("rb") as source:
        return hashlib.file_digest(source, "sha256").hexdigest()


def _is_a_series(path: str) -> bool:
    """Whether a series may have this path below the results folder; `latest` is reserved for the link to one."""
    levels = path.split("/")
    return len(levels) == 3 and not any(level in ("", "latest") or level.startswith(".") for level in levels)


def _is_below(path: str) -> bool:
    parts = PurePosixPath(path)
    return not parts.is_absolute() and bool(parts.parts) and ".." not in parts.parts
