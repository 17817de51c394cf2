"""The folder of logs on the drone's disk: partly read logs, and whole ones, compressed, by their hash.

A partly read log is `KIND.part`, a whole one `KIND.HASH.z`, to which it is renamed in one step. So a half-written log
never looks whole.
"""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import shutil
import zlib
from collections.abc import Iterator
from pathlib import Path

from ...core.disk import is_fault, sync_folder, write_all
from ...errors import ConfigurationError
from ...protocol.fields import HASH_BYTES
from ...protocol.logs import FlightLog
from ..log_work import (
    BLOCK_BYTES,
    TAIL_BYTES,
    DropLog,
    FinishLog,
    LoadLog,
    LogDone,
    LogFault,
    LogFinished,
    LogLoaded,
    LogOpened,
    LogWork,
    LogWritten,
    OpenLog,
    WholeLog,
    WriteLog,
)
from . import DEFAULT_LIMIT_MB

logger = logging.getLogger("mqttxt.logs")

RESERVE_BYTES = 64_000_000
"""Space that logs leave free on the disk: without room for the journal, commands are denied."""
_READ_BYTES = 65_536
_HEXADECIMAL = "[0-9a-f]" * 2 * HASH_BYTES
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


class LogFiles:
    """At most `limit_bytes` of logs in a folder. Raises ConfigurationError for an unusable folder.

    Use it from one thread at a time.
    """

    def __init__(
        self, folder: Path, limit_bytes: int = DEFAULT_LIMIT_MB * 1_000_000, reserve_bytes: int = RESERVE_BYTES
    ) -> None:
        self.folder = folder
        self._limit_bytes, self._reserve_bytes = limit_bytes, reserve_bytes
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for left in folder.glob("log.*.new"):
                left.unlink()
        except OSError as error:
            if not is_fault(error):
                raise ConfigurationError(f"--logs {folder}: {error.strerror}; expected a folder") from error
            logger.error("%s: %s; no logs are kept until it can be written", folder, error.strerror)

    def carry_out(self, work: LogWork) -> LogDone | None:
        """Carry out one request; an error of the disk is a LogFault."""
        turn = 0 if isinstance(work, DropLog | LoadLog) else work.turn
        try:
            if isinstance(work, OpenLog):
                return self._opened(work)
            if isinstance(work, WriteLog):
                return self._write(work)
            if isinstance(work, FinishLog):
                return LogFinished(turn, self._finish(work.log))
            if isinstance(work, LoadLog):
                return self._load(work)
            self._part(work.log).unlink(missing_ok=True)
        except OSError as error:
            reason = "disk_full" if error.errno in _FULL else "disk"
            return LogFault(turn, reason, f"{self.folder}: {error.strerror or error}")
        return None

    def _part(self, log: FlightLog) -> Path:
        return self.folder / f"{log.kind}.part"

    def _named(self, log: FlightLog, hash: bytes) -> Path:
        return self.folder / f"{log.kind}.{hash.hex()}.z"

    def _opened(self, work: OpenLog) -> LogOpened:
        """How much of a log is stored. Beyond `work.sure` bytes, the last block may not be on the disk."""
        for path in self.folder.glob(f"{work.log.kind}.{_HEXADECIMAL}.z"):
            os.utime(path)
            whole = WholeLog(bytes.fromhex(path.suffixes[-2][1:]), path.stat().st_size)
            return LogOpened(work.turn, work.log.size, b"", whole)
        try:
            with self._part(work.log).open("rb") as file:
                there = min(os.fstat(file.fileno()).st_size, work.log.size - 1)
                done = max(
                    0, (there - 1) // BLOCK_BYTES * BLOCK_BYTES, min(there, work.sure) // BLOCK_BYTES * BLOCK_BYTES
                )
                file.seek(max(0, done - TAIL_BYTES))
                return LogOpened(work.turn, done, file.read(done - file.tell()))
        except FileNotFoundError:
            return LogOpened(work.turn, 0, b"")

    def _write(self, work: WriteLog) -> LogWritten | LogFault:
        part = self._part(work.log)
        if work.offset == 0:
            self.folder.mkdir(parents=True, exist_ok=True)
            if 2 * work.log.size > self._limit_bytes:
                return LogFault(work.turn, f"too_long, {self._limit_bytes // 2}", f"{work.log.kind}")
            self._make_room(2 * work.log.size, part)
        if shutil.disk_usage(self.folder).free < self._reserve_bytes + len(work.data):
            part.unlink(missing_ok=True)
            detail = f"{self.folder}: less than {self._reserve_bytes} bytes are free"
            return LogFault(work.turn, "disk_full", detail)
        flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | (os.O_TRUNC if work.offset == 0 else 0)
        file = os.open(part, flags, 0o600)
        try:
            os.ftruncate(file, work.offset)
            os.lseek(file, work.offset, os.SEEK_SET)
            write_all(file, work.data)
            os.fsync(file)
        finally:
            os.close(file)
        return LogWritten(work.turn)

    def _make_room(self, wanted: int, spared: Path) -> None:
        """Remove the least recently used files, until `wanted` more bytes are within the limit."""
        found = sorted(
            ((path.stat().st_mtime, path) for path in self.folder.glob("log.*") if path != spared), reverse=True
        )
        used = sum(path.stat().st_size for _, path in found)
        while found and used + wanted > self._limit_bytes:
            _, oldest = found.pop()
            used -= oldest.stat().st_size
            oldest.unlink()

    def _finish(self, log: FlightLog) -> WholeLog:
        part, made = self._part(log), self.folder / f"{log.kind}.new"
        digest, size = hashlib.sha256(), 0
        try:
            with part.open("rb") as plain, made.open("wb") as file:
                os.fchmod(file.fileno(), 0o600)
                for block in _compressed(iter(lambda: plain.read(_READ_BYTES), b"")):
                    if shutil.disk_usage(self.folder).free < self._reserve_bytes + len(block):
                        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                    digest.update(block)
                    size += len(block)
                    file.write(block)
                file.flush()
                os.fsync(file.fileno())
        except OSError:
            made.unlink(missing_ok=True)
            raise
        whole = WholeLog(digest.digest()[:HASH_BYTES], size)
        os.replace(made, self._named(log, whole.hash))
        sync_folder(self.folder)
        part.unlink()
        return whole

    def _load(self, work: LoadLog) -> LogLoaded:
        try:
            with self._named(work.log, work.hash).open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                data = os.pread(file.fileno(), work.get.length, work.get.offset)
                return LogLoaded(work.ask, work.get, work.hash, data, size)
        except OSError:
            return LogLoaded(work.ask, work.get, work.hash, None, 0)


def _compressed(blocks: Iterator[bytes]) -> Iterator[bytes]:
    deflater = zlib.compressobj()
    for block in blocks:
        yield deflater.compress(block)
    yield deflater.flush()
