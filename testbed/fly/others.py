"""How much of the processors' time programs other than the fleet took while it flew."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from .quiet import STAT

TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def busy_and_total_s(path: Path = STAT) -> tuple[float, float]:
    """What programs took of all processors' time since boot, and all of it, in seconds (proc_stat(5)); Linux only.

    Time that a hypervisor gave to other machines counts as taken, interrupts do not.
    """
    first, _, _ = path.read_text(encoding="ascii").partition("\n")
    user, nice, system, idle, iowait, irq, softirq, steal, *_ = map(int, first.split()[1:])
    busy = user + nice + system + steal
    return busy / TICKS_PER_S, (busy + idle + iowait + irq + softirq) / TICKS_PER_S


class Others:
    """The other programs, from the making of this object on."""

    def __init__(self, look: Callable[[], tuple[float, float]] = busy_and_total_s) -> None:
        self._look = look
        self._before = look()

    def share(self, fleet_s: float) -> float:
        """Their share of all processors' time, of which the fleet took `fleet_s` seconds."""
        (busy_before_s, before_s), (busy_s, now_s) = self._before, self._look()
        took_s = busy_s - busy_before_s - fleet_s
        return round(max(0.0, took_s) / max(1 / TICKS_PER_S, now_s - before_s), 3)
