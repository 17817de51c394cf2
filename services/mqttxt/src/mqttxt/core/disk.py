"""Files that must survive: complete writes, and disk faults, which may pass, as opposed to wrong paths."""

from __future__ import annotations

import errno
import os
import sqlite3
from pathlib import Path
from typing import TypeGuard

_OF_A_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS})
_OF_A_DATABASE = frozenset({sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY})
_SPOILT = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
"""SQLite's errors for a file that is not a whole database, as after a power loss."""
_PRIMARY = 0xFF
"""The mask of the primary code in SQLite's extended result codes."""


def is_fault(error: OSError | sqlite3.Error) -> bool:
    """Whether the error means a full, failing or read-only disk: a role then goes on with all that needs no disk."""
    if isinstance(error, sqlite3.Error):
        return _primary_code(error) in _OF_A_DATABASE
    return error.errno in _OF_A_DISK


def is_spoilt(error: OSError | sqlite3.Error) -> TypeGuard[sqlite3.Error]:
    """Whether SQLite has found that its file is no database, or a damaged one."""
    return isinstance(error, sqlite3.Error) and _primary_code(error) in _SPOILT


def _primary_code(error: sqlite3.Error) -> int:
    return int(getattr(error, "sqlite_errorcode", 0)) & _PRIMARY


def write_all(file: int, data: bytes) -> None:
    """Write all of `data`; raises OSError. A full disk first writes a part, and then fails at the rest."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(file, rest) :]


def sync_folder(folder: Path) -> None:
    """Make a rename in a folder survive a power loss, if the file system can sync folders."""
    file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(file)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(file)
