"""A quieter moment of the machine: what is waited for before an attempt is flown again that was void.

Nothing of the testbed runs then, so what is not idle is others'.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

WINDOW_S = 2.0
"""How long is looked at a time."""
LEAST_IDLE = 0.6
"""The share of the processors' time in which they have to be idle."""
LIMIT_S = 300.0
"""How long it is waited at most; then it is flown as it is."""
STAT = Path("/proc/stat")


@dataclass(frozen=True)
class Waited:
    """How long it was waited, and the share of the processors' time that was idle at last."""

    seconds: float
    idle: float

    @property
    def is_quiet(self) -> bool:
        return self.idle >= LEAST_IDLE


def wait_for_quiet(
    look: Callable[[], tuple[int, int]] | None = None,
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> Waited:
    """Return when the processors were idle enough for `WINDOW_S`, or after `LIMIT_S`."""
    look = look or processor_times
    began_s = clock()
    before = look()
    while True:
        sleep(WINDOW_S)
        now = look()
        idle = (now[0] - before[0]) / max(1, now[1] - before[1])
        found, before = Waited(round(clock() - began_s, 1), round(idle, 3)), now
        if found.is_quiet or found.seconds >= LIMIT_S:
            return found


def processor_times(path: Path = STAT) -> tuple[int, int]:
    """Idle time of all processors since boot, and all of it, in the kernel's ticks (proc_stat(5)); Linux only.

    What gives way to everybody else (a nice value above 0) counts as idle, what a hypervisor gave to others as busy.
    """
    first, _, _ = path.read_text(encoding="ascii").partition("\n")
    user, nice, system, idle, iowait, irq, softirq, steal, *_ = map(int, first.split()[1:])
    return nice + idle + iowait, user + nice + system + idle + iowait + irq + softirq + steal
