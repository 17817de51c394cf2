"""Writes cpio archives (newc), as the kernel unpacks them into its first root file system; see initramfs' format
(Documentation/driver-api/early-userspace/buffer-format.rst). Archives can stand one behind the other in one file.
"""

from __future__ import annotations

import stat
from typing import BinaryIO

_ALIGNMENT = 4


class Archive:
    """Write folders before what is in them, then `end`."""

    def __init__(self, out: BinaryIO) -> None:
        self._out = out
        self._number = 0

    def folder(self, name: str) -> None:
        self._entry(name, stat.S_IFDIR | 0o755, b"")

    def link(self, name: str, target: str) -> None:
        self._entry(name, stat.S_IFLNK | 0o777, target.encode())

    def file(self, name: str, content: bytes, executable: bool) -> None:
        self._entry(name, stat.S_IFREG | (0o755 if executable else 0o644), content)

    def console(self) -> None:
        """What the kernel gives to its first process as input and output."""
        self._entry("dev/console", stat.S_IFCHR | 0o600, b"", (5, 1))

    def end(self) -> None:
        self._entry("TRAILER!!!", 0, b"")

    def _entry(self, name: str, mode: int, content: bytes, device: tuple[int, int] = (0, 0)) -> None:
        self._number += 1
        path = name.encode() + b"\0"
        fields = (self._number, mode, 0, 0, 1, 0, len(content), 0, 0, *device, len(path), 0)
        head = b"070701" + b"".join(b"%08X" % field for field in fields) + path
        self._out.write(head + bytes(-len(head) % _ALIGNMENT))
        self._out.write(content + bytes(-len(content) % _ALIGNMENT))
