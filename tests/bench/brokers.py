"""Mosquittos for the benchmarks, and what processes have used of the machine."""

from __future__ import annotations

import os
from pathlib import Path

from mqttxt.core.embedded_broker import CONFIGURATION
from tests.rigs.processes import Broker, wait_until

_TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")


class BenchBroker(Broker):
    """A Mosquitto with the configuration of an embedded broker; `more` adds lines to it."""

    def __init__(self, folder: Path, name: str, more: str = "") -> None:
        super().__init__(folder, name)
        self.configuration.write_text(CONFIGURATION.format(host="127.0.0.1", port=self.port) + more)

    @property
    def pid(self) -> int:
        """Its process, as the host sees it."""
        self._container.reload()
        return int(self._container.attrs["State"]["Pid"])


def cpu_s(*pids: int) -> float:
    """User and system time that processes have used so far."""
    total = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        total += int(fields[11]) + int(fields[12])
    return total / _TICKS_A_SECOND


def rss_mb(pid: int) -> float:
    """Resident memory of a process, in megabytes (10^6 bytes)."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


__all__ = ["BenchBroker", "cpu_s", "rss_mb", "wait_until"]
