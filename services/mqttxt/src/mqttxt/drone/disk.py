"""Faults that come and go with a disk, as against a path that a person gave wrongly."""

from __future__ import annotations

import errno
import sqlite3

_OF_A_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS})
_OF_A_DATABASE = frozenset({sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY})
_PRIMARY = 0xFF
"""Of sqlite's extended result codes."""


def is_fault(error: OSError | sqlite3.Error) -> bool:
    """Whether a disk is full, failing or read-only: with that a role goes on, and does what needs no disk."""
    if isinstance(error, sqlite3.Error):
        return getattr(error, "sqlite_errorcode", 0) & _PRIMARY in _OF_A_DATABASE
    return error.errno in _OF_A_DISK
