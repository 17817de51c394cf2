"""A disk that a test can fill."""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
from pathlib import Path


class SmallDisk:
    """A disk of 128 KiB: a file system in memory if this user may mount one, else a limit on each file's size."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        command = ["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", str(folder)]
        self.is_mounted = (
            os.geteuid() == 0 and subprocess.run(command, capture_output=True, check=False).returncode == 0
        )
        self._limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(self, to_the_brim: bool = False) -> None:
        """Leave no room. Without a mount, smaller files can grow to the largest one's size, unless `to_the_brim`."""
        if not self.is_mounted:
            largest = 0 if to_the_brim else max((f.stat().st_size for f in self.folder.iterdir()), default=0)
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, self._limits[1]))
            return
        with contextlib.suppress(OSError), (self.folder / "filler").open("wb", buffering=0) as filler:
            while True:
                filler.write(bytes(4096))

    def make_room(self) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, self._limits)
        (self.folder / "filler").unlink(missing_ok=True)

    def close(self) -> None:
        self.make_room()
        if self.is_mounted:
            subprocess.run(["umount", "-l", str(self.folder)], check=True)
