"""The readings that a drone carries: a bounded sqlite file that survives a crash and a power loss.

Write-ahead log with full synchronisation: a finished transaction is on the disk.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from ...core.disk import is_fault, is_spoilt
from ...errors import ConfigurationError, PayloadError
from ...protocol.codec import decode, encode
from ...protocol.readings import Reading, ReadingKey, ReadingMessage, checked
from ...security.cose import Envelope
from ..effects import LoadReadings, StoreReading
from . import DEFAULT_LIMIT

logger = logging.getLogger("mqttxt.sensors")

_VERSION = 1
_SCHEMA = """
CREATE TABLE reading (
    place INTEGER PRIMARY KEY AUTOINCREMENT,
    sensor INTEGER NOT NULL,
    boot INTEGER NOT NULL,
    seq INTEGER NOT NULL,
    kind TEXT NOT NULL,
    payload BLOB NOT NULL,
    UNIQUE (sensor, boot, seq)
)
"""
_KEY = "sensor = ? AND boot = ? AND seq = ?"


@dataclass
class Batch:
    """The work of one transaction: forget, then store, then load."""

    forget: list[ReadingKey] = field(default_factory=list)
    store: list[StoreReading] = field(default_factory=list)
    load: LoadReadings | None = None

    def __bool__(self) -> bool:
        return bool(self.forget or self.store or self.load)


@dataclass
class Done:
    """The result of a batch. `reason`: why readings were refused; `rows` are places and readings, oldest first."""

    stored: list[StoreReading] = field(default_factory=list)
    refused: list[StoreReading] = field(default_factory=list)
    reason: str = ""
    rows: list[tuple[int, Reading]] = field(default_factory=list)
    failed: bool = False
    """Nothing of the batch was done, and the readings to forget are still stored."""


class SensorStore:
    """At most `limit` readings in `path`, for one process at a time. Raises ConfigurationError for an unusable file.

    A spoilt file is renamed to `path.spoilt-NUMBER`, and a new one takes its place.

    Use it from one thread at a time. A reading that is already stored counts as stored. While the disk is full or
    fails, even at the start, readings are refused.
    """

    def __init__(self, path: Path, limit: int = DEFAULT_LIMIT) -> None:
        self.path = path
        self.limit = limit
        self._count = 0
        self._is_open = False
        self._spoilt: sqlite3.Error | None = None
        """Why the file is to be renamed."""
        self._loaded = 0
        """The highest place of a loaded reading; those of a new file are behind it."""
        try:
            self._open()
        except (OSError, sqlite3.Error) as error:
            if not is_fault(error):
                raise ConfigurationError(f"--sensor-store {path}: cannot be used: {error}") from error
            logger.error("%s: %s; new readings stay with their sensors until it can be written", path, error)

    def __len__(self) -> int:
        return self._count

    def carry_out(self, batch: Batch) -> Done:
        """Carry a batch out as one transaction, which is on the disk on return. After an error all of it is refused."""
        done = Done()
        count = self._count
        try:
            self._open()
            count = self._count
            self._database.execute("BEGIN IMMEDIATE")
            self._forget(batch.forget)
            for effect in batch.store:
                self._store(effect, done)
            if batch.load is not None:
                done.rows = self._load(batch.load)
            self._database.execute("COMMIT")
        except (OSError, sqlite3.Error) as error:
            self._count = count
            if not self._is_open:
                return Done(refused=batch.store, reason=f"{self.path}: {error}", failed=True)
            with contextlib.suppress(sqlite3.Error):  # after some errors sqlite has already rolled back
                self._database.execute("ROLLBACK")
            if is_spoilt(error):
                self.close()
                self._is_open, self._spoilt = False, error
            return Done(refused=batch.store, reason=f"{self.path}: {error}", failed=True)
        return done

    def close(self) -> None:
        if not self._is_open:
            return
        with contextlib.suppress(sqlite3.Error):  # finished transactions are already on the disk
            self._database.close()

    def _open(self) -> None:
        """Open the file if it is not open, as after a start on a full disk."""
        if self._is_open:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self._spoilt is None:
            try:
                self._connect()
                return
            except sqlite3.Error as error:
                if not is_spoilt(error):
                    raise
                self._spoilt = error
        self._set_aside(self._spoilt)
        self._spoilt = None
        self._connect()

    def _set_aside(self, why: sqlite3.Error) -> None:
        """Rename the file, after its log of changes, which would spoil a new file."""
        names = (self.path.with_name(f"{self.path.name}.spoilt-{number}") for number in itertools.count(1))
        aside = next(name for name in names if not name.exists())
        for suffix in ("-wal", ""):
            with contextlib.suppress(FileNotFoundError):
                self.path.with_name(self.path.name + suffix).rename(aside.with_name(aside.name + suffix))
        logger.error("%s: %s; it is kept as %s, and a new file takes the readings", self.path, why, aside.name)

    def _connect(self) -> None:
        self._database = sqlite3.connect(self.path, timeout=1.0, isolation_level=None, check_same_thread=False)
        try:
            self._count = self._prepare()
        except sqlite3.Error:
            self._database.close()
            raise
        self._is_open = True

    def _prepare(self) -> int:
        run = self._database.execute
        run("PRAGMA locking_mode = EXCLUSIVE")
        run("PRAGMA journal_mode = WAL")
        run("PRAGMA synchronous = FULL")
        run("BEGIN EXCLUSIVE")
        (version,) = run("PRAGMA user_version").fetchone()
        if version == 0:
            run(_SCHEMA)
            run("INSERT INTO sqlite_sequence VALUES ('reading', ?)", (self._loaded,))
            run(f"PRAGMA user_version = {_VERSION}")
        elif version != _VERSION:
            raise sqlite3.DatabaseError(f"expected version {_VERSION} of its tables, got {version}")
        (count,) = run("SELECT count(*) FROM reading").fetchone()
        run("COMMIT")
        return int(count)

    def _forget(self, keys: Iterable[ReadingKey]) -> None:
        for key in keys:
            found = self._database.execute(f"DELETE FROM reading WHERE {_KEY}", (key.sensor, key.boot, key.seq))
            self._count -= found.rowcount

    def _store(self, effect: StoreReading, done: Done) -> None:
        reading = effect.reading
        key = reading.key
        row = (key.sensor, key.boot, key.seq)
        if self._database.execute(f"SELECT 1 FROM reading WHERE {_KEY}", row).fetchone() is not None:
            done.stored.append(effect)
            return
        if self._count >= self.limit:
            done.refused.append(effect)
            done.reason = f"{self.path}: full with {self.limit} readings"
            return
        self._database.execute(
            "INSERT INTO reading (sensor, boot, seq, kind, payload) VALUES (?, ?, ?, ?, ?)",
            (*row, reading.kind, reading.said or encode(reading.message)),
        )
        self._count += 1
        done.stored.append(effect)

    def _load(self, wanted: LoadReadings) -> list[tuple[int, Reading]]:
        rows: list[tuple[int, Reading]] = []
        spoilt: list[int] = []
        found = self._database.execute(
            "SELECT place, sensor, kind, payload FROM reading WHERE place > ? ORDER BY place", (wanted.after,)
        )
        for place, sensor, kind, payload in found:
            try:
                rows.append((place, _restored(sensor, kind, payload)))
            except PayloadError as error:
                logger.error("%s: reading at place %d is corrupt and is removed: %s", self.path, place, error)
                spoilt.append(place)
            self._loaded = max(self._loaded, place)
            if len(rows) == wanted.most:
                break
        found.close()
        for place in spoilt:
            self._database.execute("DELETE FROM reading WHERE place = ?", (place,))
            self._count -= 1
        return rows


def _restored(sensor: int, kind: str, payload: bytes) -> Reading:
    """A stored reading, signed or not. Raises PayloadError."""
    try:
        signed = Envelope.parse(payload)
    except PayloadError:
        return checked(sensor, kind, decode(ReadingMessage, payload))
    return checked(sensor, kind, decode(ReadingMessage, signed.payload), payload)
