"""The wall clock for certificates: a drone may have none at boot, and this time never goes back."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path

from ..errors import ConfigurationError
from . import files
from .certificate import Certificate
from .fleet import Fleet

logger = logging.getLogger("mqttxt.identity")

TIME_FILE = "time"
PERSIST_EVERY_S = 600.0


class TrustedTime:
    """The later of the system's clock and a known time plus the time that has passed since.

    Known times are that in `folder`, unless its file is spoilt, the revocation list's, and starts of validity. Without
    a battery-backed clock a machine starts in 1970, or where it stopped. `system` returns Unix seconds, `running`
    seconds since any start; tests pass their own.
    """

    def __init__(
        self,
        folder: Path,
        fleet: Fleet,
        system: Callable[[], float] = time.time,
        running: Callable[[], float] = time.monotonic,
    ) -> None:
        self._file = folder / TIME_FILE
        self._fleet = fleet
        self._system = system
        self._running = running
        self._at_start_s = _read(self._file) - running()

    def now_s(self) -> float:
        """Unix seconds."""
        return max(self._system(), self._least_s())

    def verify(self, certificate: Certificate) -> str | None:
        """Why a certificate is invalid now; None if it is valid (`Fleet.verify`).

        A clock that is behind a known time cannot tell that a certificate is not yet valid: the authority's signature
        shows that its start has passed.
        """
        verdict = self._fleet.verify(certificate, self.now_s())
        if verdict == "not_yet_valid" and self._system() < self._least_s():
            self._learn(certificate.not_before_s)
            return None
        return verdict

    def _least_s(self) -> float:
        """The latest known time, whatever the system's clock shows."""
        known_s = self._at_start_s + self._running()
        listed_s = self._fleet.revoked.this_update_s
        if listed_s > known_s:
            self._learn(listed_s)
        return max(known_s, listed_s)

    def _learn(self, now_s: float) -> None:
        self._at_start_s = now_s - self._running()

    def keep(self) -> None:
        """Write the time to the folder, for a start without a clock; blocks. Raises ConfigurationError."""
        now_s = self.now_s()
        files.write(self._file, f"{int(now_s)}\n".encode())
        self._learn(now_s)


def _read(path: Path) -> float:
    if not path.exists():
        return 0.0
    try:
        text = files.read(path).strip()
        if text.isdigit() and len(text) <= 12:
            return float(text)
        raise ConfigurationError(f"{path}: {text[:40]!r}; expected Unix seconds, or no such file")
    except ConfigurationError as error:  # as after a power loss
        logger.error("%s; the other known times count", error)
        return 0.0
