"""The time of all processors since boot, and how much of it programs other than the fleet took while it flew."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

STAT = Path("/proc/stat")
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Ticks(NamedTuple):
    """The kernel's ticks of all processors since boot, by what they were for (proc_stat(5))."""

    user: int
    nice: int
    system: int
    idle: int
    iowait: int
    irq: int
    softirq: int
    steal: int

    @property
    def programs(self) -> int:
        """What programs took; time that a hypervisor gave to other machines counts, interrupts do not."""
        return self.user + self.nice + self.system + self.steal


def read_ticks(path: Path = STAT) -> Ticks:
    """Read them; Linux only."""
    first, _, _ = path.read_text(encoding="ascii").partition("\n")
    return Ticks(*map(int, first.split()[1 : 1 + len(Ticks._fields)]))


class Others:
    """The other programs, from the making of this object on."""

    def __init__(self, look: Callable[[], Ticks] = read_ticks) -> None:
        self._look = look
        self._before = look()

    def share(self, fleet_s: float) -> float:
        """Their share of all processors' time, of which the fleet took `fleet_s` seconds."""
        before, now = self._before, self._look()
        took = now.programs - before.programs - fleet_s * TICKS_PER_S
        return round(max(0.0, took) / max(1, sum(now) - sum(before)), 3)
