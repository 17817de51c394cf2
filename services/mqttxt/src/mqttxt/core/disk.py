"""Files that have to last: written whole, and faults that come and go with a disk, as against a wrong path."""

from __future__ import annotations

import errno
import os
import sqlite3
from pathlib import Path

_OF_A_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS})
_OF_A_DATABASE = frozenset({sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY})
_PRIMARY = 0xFF
"""Of sqlite's extended result codes."""


def is_fault(error: OSError | sqlite3.Error) -> bool:
    """Whether a disk is full, failing or read-only: with that a role goes on, and does what needs no disk."""
    if isinstance(error, sqlite3.Error):
        return getattr(error, "sqlite_errorcode", 0) & _PRIMARY in _OF_A_DATABASE
    return error.errno in _OF_A_DISK


def write_all(file: int, data: bytes) -> None:
    """All of it; what a full disk took only a part of fails at the next part."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(file, rest) :]


def sync_folder(folder: Path) -> None:
    """Make a renaming last over a power loss, where the file system can be asked to."""
    file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(file)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(file)
