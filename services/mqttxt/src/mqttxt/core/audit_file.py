"""The files of an audit log: one chain, unbroken by full disks, power losses and rotation (protocol, section 14).

After a failed write or sync the content of the file is unknown. So the lines since the last successful sync stay in
memory; after a failure the file is cut back to that sync, and they are written again.
"""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import ConfigurationError
from ..security.audit_chain import Line, Link
from ..security.audit_verdict import followed, older_files
from ..security.seal import Seal
from .disk import sync_folder, write_all

logger = logging.getLogger("mqttxt.audit")

LARGEST = 8 * 1024 * 1024
MOST = 8


class AuditFile:
    """The log of `node` at `path`: at most `most` files, each of `largest` bytes and one sync more.

    Older files are `path.NUMBER`, with the number of their first line. `open`, `flush` and `sync` block and raise
    OSError: then call `fail`, and go on with `open`. `open` raises ConfigurationError if the file is no audit log or
    another node's, BlockingIOError if a process has it.
    """

    def __init__(self, path: Path, node: str, largest: int = LARGEST, most: int = MOST) -> None:
        self.path = followed(path)
        self._node = node
        self._largest, self._most = largest, most
        self._file: int | None = None
        self._link: Link | None = None
        self._first_n = 1
        self._size = 0
        """Bytes of the file that are surely on disk; the file is longer by what was written since."""
        self._unsynced: list[bytes] = []
        self._written = 0
        """How many of the unsynced lines are written to the file."""

    @property
    def is_synced(self) -> bool:
        return not self._unsynced

    def open(self, now_s: float) -> None:
        """Make ready to add lines; does nothing if the file is open already."""
        if self._file is None:
            self._file = _open_locked(self.path)
            if self._link is None:
                self._find_end(now_s)
            os.ftruncate(self._file, self._size)
            self._written = 0

    def add(self, now_s: float, event: str, fields: Mapping[str, Any]) -> None:
        """Chain a line; `flush` writes it."""
        assert self._link is not None
        self._link, line = self._link.next(now_s, event, fields)
        self._unsynced.append(line)

    def sign(self, now_s: float, seal: Seal) -> None:
        """Chain a `head`: a signature over all lines before it."""
        assert self._link is not None
        self.add(now_s, "head", {"sign1": self._link.signature(seal)})

    def flush(self) -> None:
        """Write the added lines to the file."""
        assert self._file is not None
        if self._written < len(self._unsynced):
            write_all(self._file, b"".join(self._unsynced[self._written :]))
            self._written = len(self._unsynced)

    def sync(self, now_s: float) -> None:
        """Bring the added lines to the disk; if the file is full then, go on in a new one."""
        assert self._file is not None
        self.flush()
        os.fsync(self._file)
        self._size += sum(map(len, self._unsynced))
        self._unsynced, self._written = [], 0
        if self._size >= self._largest:
            self._rotate(now_s)

    def fail(self) -> None:
        """Close the file after an error: its content after the last sync is unknown, and `open` cuts it off."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _rotate(self, now_s: float) -> None:
        for oldest in older_files(self.path)[: 2 - self._most or None]:
            oldest.unlink()
        self.path.rename(self.path.with_name(f"{self.path.name}.{self._first_n:09d}"))
        self.fail()
        self._size = 0
        self._begin_file(now_s)
        sync_folder(self.path.parent)
        self.open(now_s)
        self.flush()

    def _begin_file(self, now_s: float) -> None:
        assert self._link is not None
        self._first_n = self._link.n + 1
        self.add(now_s, "file", {"node": self._node, "before": self._link.hash})

    def _find_end(self, now_s: float) -> None:
        """Continue the chain after the last line of this file, or of the newest older one if this one has no line."""
        self._size = size = self._read_end(self.path)
        if self._link is not None:
            cut = os.stat(self.path).st_size - size
            if cut:
                logger.warning("audit log %s: its last line had no end; %d bytes are cut off", self.path, cut)
                self.add(now_s, "repaired", {"cut_bytes": cut})
            return
        for older in reversed(older_files(self.path)):
            if self._link is None:
                self._read_end(older)
        self._link = self._link or Link()
        self._begin_file(now_s)

    def _read_end(self, path: Path) -> int:
        """Take the link of the last readable line; returns the number of bytes in whole lines."""
        lines = path.read_bytes().split(b"\n")[:-1]
        if not lines:
            return 0
        size = sum(len(line) + 1 for line in lines)
        head = _parsed(lines[0])
        first = head or next(filter(None, map(_parsed, lines)), None)
        if first is None and all(line.isascii() and b"\0" not in line for line in lines):
            raise ConfigurationError(f"audit log {path}: line 1: it cannot be read; expected an audit log, or no file")
        if head is None:
            logger.error("audit log %s: line 1 cannot be read; it is left there, for `mqttxt audit verify`", path)
        if first is None:
            return size
        node = head.fields.get("node") if head is not None else self._node
        if node != self._node:
            raise ConfigurationError(f"audit log {path}: of {node}; expected that of {self._node}, or no file")
        self._first_n = first.link.n
        for number in range(len(lines), 0, -1):
            try:
                self._link = Line.parse(lines[number - 1]).link
                break
            except ValueError as error:
                logger.error(
                    "audit log %s: line %d: %s; it is left there, for `mqttxt audit verify`", path, number, error
                )
        return size


def _parsed(line: bytes) -> Line | None:
    try:
        return Line.parse(line)
    except ValueError:
        return None


def _open_locked(path: Path) -> int:
    """Open and lock a file, if its file system has locks; raises BlockingIOError if another process has it."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise OSError(errno.EINVAL, "not a regular file")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        raise
    except OSError as error:
        logger.debug("audit log %s: no lock: %s", path, error)
    return file
