"""The journal's front: records in memory that outlive the UAV client's process, for the time until a disk has them.

A disk may take seconds for a record: an SD card erases a block, or other programs' writes fill the queue. The front
takes it at once. It is a file in a file system in memory, which a loss of power erases. The journal on the disk names
it, so that a missing front is recognised as a gap.
"""

from __future__ import annotations

import os
import re
import secrets
import stat
from pathlib import Path
from typing import Self

from ..core.disk import write_all

FOLDER = Path("/dev/shm")
"""Linux's file system in memory."""
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_NAME = re.compile(r"mqttxt-[0-9a-f-]{36}-[0-9a-f]{16}")


class Front:
    """The front of one run, `name` in the folder. The name has the machine's boot id: other boots do not use it.

    Raises OSError if the folder does not exist or has no room.
    """

    def __init__(self) -> None:
        self.name = f"mqttxt-{_boot_id()}-{secrets.token_hex(8)}"
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
        self._file = os.open(FOLDER / self.name, flags, 0o600)

    @classmethod
    def create(cls) -> Self | None:
        """A new front; None if the machine has no place for it."""
        try:
            return cls()
        except OSError:
            return None

    def append(self, line: bytes) -> None:
        """Append a record. Raises OSError, and then leaves the front as it was."""
        size = os.fstat(self._file).st_size
        try:
            write_all(self._file, line)
        except OSError:
            os.ftruncate(self._file, size)
            raise

    def clear(self) -> None:
        """Remove all records, because the disk has them."""
        os.ftruncate(self._file, 0)

    def close(self) -> None:
        os.close(self._file)


def read(name: str) -> str | None:
    """The contents of the front `name`; None if this boot and this user have no such front."""
    if _NAME.fullmatch(name) is None:
        return None
    try:
        if not name.startswith(f"mqttxt-{_boot_id()}-"):
            return None
        file = os.open(FOLDER / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    with open(file, encoding="ascii", errors="replace") as opened:
        found = os.fstat(file)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid():
            return None
        return opened.read()


def remove(name: str) -> None:
    """Remove the front of that name, if there is one."""
    if _NAME.fullmatch(name) is not None:
        (FOLDER / name).unlink(missing_ok=True)


def _boot_id() -> str:
    return _BOOT_ID.read_text(encoding="ascii").strip()
