"""A disk that fails on demand."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from typing import Any


class FaultyDisk:
    """The `os` functions that a log uses, on a disk that fails as `faults` says: one entry for each call.

    A sync that fails loses what was written since the last one; so does a power loss.
    """

    def __init__(self, faults: Iterator[str]) -> None:
        self.faults = faults
        self.synced: dict[int, int] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def open(self, path: Any, flags: int, mode: int = 0o777) -> int:
        self._may_fail("open")
        file = os.open(path, flags, mode)
        self.synced[file] = os.fstat(file).st_size
        return file

    def write(self, file: int, data: Any) -> int:
        fault = next(self.faults)
        if fault == "partly":
            return os.write(file, data[: max(1, len(data) // 2)])
        if fault == "write":
            raise OSError(errno.ENOSPC, "full")
        return os.write(file, data)

    def fsync(self, file: int) -> None:
        if next(self.faults) == "sync":
            if not os.path.isdir(f"/proc/self/fd/{file}"):
                os.truncate(f"/proc/self/fd/{file}", self.synced[file])
            raise OSError(errno.EIO, "lost")
        self.synced[file] = os.fstat(file).st_size

    def _may_fail(self, what: str) -> None:
        if next(self.faults) == what:
            raise OSError(errno.EIO, what)
