"""The wall clock as certificates need it: a drone may have none at boot, and time never goes back."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from ..errors import ConfigurationError
from . import files
from .fleet import Fleet

TIME_FILE = "time"
PERSIST_EVERY_S = 600.0


class TrustedTime:
    """The latest of the system's clock, the time that `folder` keeps, and the revocation list's.

    Without a battery-backed clock a machine starts in 1970, or where it ended: a certificate is judged by the latest
    time that the node has known. `system` gives Unix seconds; tests hand in their own.
    """

    def __init__(self, folder: Path, fleet: Fleet, system: Callable[[], float] = time.time) -> None:
        self._file = folder / TIME_FILE
        self._fleet = fleet
        self._system = system
        self._kept_s = _read(self._file)

    def now_s(self) -> float:
        """Unix seconds."""
        return max(self._system(), self._kept_s, self._fleet.revoked.this_update_s)

    def keep(self) -> None:
        """Write the time down, for a start without a clock; blocks. Raises ConfigurationError."""
        now_s = self.now_s()
        files.write(self._file, f"{int(now_s)}\n".encode())
        self._kept_s = now_s


def _read(path: Path) -> float:
    if not path.exists():
        return 0.0
    text = files.read(path).strip()
    if not (text.isdigit() and len(text) <= 12):
        raise ConfigurationError(f"{path}: {text[:40]!r}; expected Unix seconds, or no such file")
    return float(text)
