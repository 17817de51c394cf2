"""A flight log's download into a file: resumed where it broke off, and under its own name only when whole."""

from __future__ import annotations

import asyncio
import glob
import hashlib
import os
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..errors import ConfigurationError, TransferFailed
from ..protocol.fields import HASH_BYTES
from ..protocol.logs import FlightLog
from ..security.files import named_by_user
from .fog import FogView
from .log_transfers import LogPieces, LogWait
from .process import StationRunner, check_timeout
from .transfers import ATTEMPTS

LEAST_BYTES_S, MOST_BYTES_S = 1024, 131_072
_READ_BYTES = 65_536


@dataclass(frozen=True)
class LogProgress:
    """The progress of a log's download.

    Parameters:
        is_at_drone: the drone has the whole log and sends it; else it still reads it from its autopilot.
        done: bytes of the log that the drone has read, or of the compressed log that have arrived.
        size: how many bytes there are in all.
    """

    is_at_drone: bool
    done: int
    size: int


class LogDownload:
    """The download of one log of a drone into one file; `run` it once."""

    def __init__(
        self,
        runner: StationRunner,
        fog: FogView,
        drone: int,
        log: FlightLog,
        path: Path,
        most_bytes_s: int,
        progress: Callable[[LogProgress], None] | None,
    ) -> None:
        self._runner, self._fog, self._drone = runner, fog, drone
        self._log, self._path = log, path
        self._most_bytes_s = most_bytes_s
        self._progress = progress

    async def run(self, timeout_s: float | None) -> None:
        """`Drone.download_log`."""
        if timeout_s is not None:
            check_timeout(timeout_s)
        self._path = await asyncio.to_thread(named_by_user, self._path)
        try:
            async with asyncio.timeout(timeout_s) as limit:
                for attempt in range(ATTEMPTS):
                    try:
                        await self._once()
                        return
                    except TransferFailed as error:  # the drone was restarted, or a disk has altered the bytes
                        if attempt == ATTEMPTS - 1 or error.reason not in ("unknown_hash", "wrong_hash"):
                            raise
        except TimeoutError:
            if not limit.expired():  # it is the caller's own
                raise
            raise TransferFailed(f"drone {self._drone}: {self._log.kind}: not within {timeout_s:g} s") from None

    async def _once(self) -> None:
        waited = LogWait(self._fog, self._drone, self._log)

        async def tell() -> None:
            waited.told = waited.done
            self._tell(False, waited.done, self._log.size)

        await self._runner.transfer(waited, None, tell)
        part = _Part(self._path, waited.hash, waited.size)
        try:
            start = await asyncio.to_thread(part.open)
            pieces = LogPieces(waited, start, self._most_bytes_s)

            async def keep() -> None:
                await asyncio.to_thread(part.write, pieces.take_out())
                self._tell(True, pieces.arrived, waited.size)

            if start < waited.size:
                await self._runner.transfer(pieces, None, keep)
            await keep()
        finally:
            await asyncio.to_thread(part.close)
        if not await asyncio.to_thread(part.finish, self._log.size):
            raise TransferFailed(f"{waited}: wrong_hash", "wrong_hash")

    def _tell(self, is_at_drone: bool, done: int, size: int) -> None:
        if self._progress is not None:
            self._progress(LogProgress(is_at_drone, done, size))


class _Part:
    """The received bytes of a log that a hash names, in a hidden file beside its target. Every method blocks.

    A cancelled download closes it while a thread may be about to open it, or to write: its descriptor is then another
    file's.

    Raises ConfigurationError for a disk error; the received bytes are kept for another attempt.
    """

    def __init__(self, target: Path, hash: bytes, size: int) -> None:
        self._target, self._hash, self._size = target, hash, size
        self._path = target.with_name(f".{target.name}.{hash.hex()}.part")
        self._file = -1
        self._is_closed = False
        self._lock = threading.Lock()

    def open(self) -> int:
        """Open the hidden file; returns its size. Those of other logs for the same target are removed."""
        with self._lock, self._changing():
            if self._is_closed:
                return 0
            for other in self._target.parent.glob(f".{glob.escape(self._target.name)}.*.part"):
                if other != self._path:
                    other.unlink()
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o600)
            there = os.lseek(self._file, 0, os.SEEK_END)
            if there > self._size:
                os.ftruncate(self._file, 0)
                there = os.lseek(self._file, 0, os.SEEK_SET)
            return there

    def write(self, data: bytes) -> None:
        with self._lock, self._changing():
            rest = memoryview(data)
            while rest:
                rest = rest[os.write(self._file, rest) :]

    def close(self) -> None:
        with self._lock:
            file, self._file, self._is_closed = self._file, -1, True
            if file >= 0:
                os.close(file)

    def finish(self, size: int) -> bool:
        """Unpack it into the target, a log of `size` bytes. False, and it is removed, if its hash is wrong."""
        made = self._target.with_name(f".{self._target.name}.new")
        with self._changing():
            digest = hashlib.sha256()
            with self._path.open("rb") as packed:
                for block in iter(lambda: packed.read(_READ_BYTES), b""):
                    digest.update(block)
            if digest.digest()[:HASH_BYTES] != self._hash:
                self._path.unlink()
                return False
            try:
                with made.open("wb") as file:
                    is_it = _unpack(self._path, file.write, size)
                    file.flush()
                    os.fsync(file.fileno())
                if is_it:
                    os.replace(made, self._target)
            finally:
                made.unlink(missing_ok=True)
            self._path.unlink()
            if not is_it:
                raise TransferFailed(f"{self._target.name}: expected a log of {size} bytes")
            return True

    @contextmanager
    def _changing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise ConfigurationError(f"{self._target}: {error.strerror or error}") from error


def _unpack(path: Path, write: Callable[[bytes], object], size: int) -> bool:
    """Decompress a file into `write`; False where that is not `size` bytes. It stops where there are more."""
    inflater, made = zlib.decompressobj(), 0
    try:
        with path.open("rb") as file:
            for block in iter(lambda: file.read(_READ_BYTES), b""):
                while block and made <= size:
                    plain = inflater.decompress(block, _READ_BYTES)
                    block = inflater.unconsumed_tail
                    made += len(plain)
                    write(plain)
            rest = inflater.flush() if made <= size else b""
            write(rest)
    except zlib.error:
        return False
    return inflater.eof and made + len(rest) == size
