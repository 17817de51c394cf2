"""Time stamps for signed MAVLink messages: none is used twice, even after restarts and with wrong clocks (R13.3)."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from ...errors import ConfigurationError
from ...security import files

logger = logging.getLogger("mqttxt.mavlink")

TICKS_PER_S: Final = 100_000
EPOCH_S: Final = 1_420_070_400
"""2015-01-01 in Unix seconds."""
MOST: Final = 2**48 - 1
LEAST_AHEAD, MOST_AHEAD = 4 * TICKS_PER_S, 60 * TICKS_PER_S
"""Bounds on how far the file is ahead of the used time stamps. It is as long as the client has been running, so that
repeated restarts do not run far ahead of the clock.
"""
KEEP_EVERY_S = 1.0


class Stamps:
    """Time stamps in 10 µs since 2015. The file `path` is ahead of all used ones: after a restart they continue there.

    The file has a copy, in case a power loss spoils one of the two. Without a `path` nothing is kept.

    `system` gives Unix seconds. Raises ConfigurationError if neither the file nor its copy has a time stamp.
    """

    def __init__(self, path: Path | None = None, system: Callable[[], float] = time.time) -> None:
        self._path = path
        self._system = system
        self._kept = _read_kept(path) if path is not None else 0
        self._last = self._kept
        self._first = self.now()

    def now(self) -> int:
        """The current time stamp, without using it for a message."""
        return min(MOST, max(self._last, int((self._system() - EPOCH_S) * TICKS_PER_S)))

    def next(self) -> int | None:
        """The time stamp of the next message, None once all are used up."""
        if self._last >= MOST:
            return None
        self._last = max(self._last + 1, self.now())
        return self._last

    def adopt(self, stamp: int) -> None:
        """Continue after a time stamp that another holder of the key has used."""
        self._last = max(self._last, stamp)

    @property
    def is_due(self) -> bool:
        """Whether the file is to be written anew."""
        return self._path is not None and self._kept < min(MOST, self.now() + self._ahead() // 2)

    def keep(self) -> None:
        """Write the copy and the file; blocks. Raises ConfigurationError if the write fails."""
        assert self._path is not None
        kept = min(MOST, self.now() + self._ahead())
        for file in (_copy_of(self._path), self._path):
            files.write(file, f"{kept}\n".encode())
        self._kept = kept

    def _ahead(self) -> int:
        return max(LEAST_AHEAD, min(MOST_AHEAD, self.now() - self._first))


def _copy_of(path: Path) -> Path:
    return path.with_name(f"{path.name}.copy")


def _read_kept(path: Path) -> int:
    """The later time stamp of the file and its copy, 0 if there is neither.

    With both spoilt it does not go on from 0: where the clock is behind, recorded messages would then be heard (R13.4).
    """
    kept, wrong = list[int](), list[ConfigurationError]()
    for file in (path, _copy_of(path)):
        try:
            kept += [_read(file)] if file.exists() else []
        except ConfigurationError as error:
            wrong.append(error)
    if wrong and not kept:
        raise wrong[0]
    for spoilt in wrong:
        logger.error("%s; its copy is used", spoilt)
    return max(kept, default=0)


def _read(path: Path) -> int:
    text = files.read(path).strip()
    if not (text.isdigit() and len(text) <= 15 and int(text) <= MOST):
        raise ConfigurationError(f"{path}: {text[:40]!r}; expected a MAVLink time stamp, or no such file")
    return int(text)
