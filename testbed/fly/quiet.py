"""Waits for a quieter moment of the machine before a void attempt is flown again.

The testbed runs nothing meanwhile, so the load is that of other programs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from .processors import STAT, read_ticks

WINDOW_S = 2.0
"""The length of one observation."""
LEAST_IDLE = 0.6
"""The share of the processors' time that must be idle."""
LIMIT_S = 300.0
"""The longest wait; then the attempt is flown anyway."""


@dataclass(frozen=True)
class Waited:
    """The seconds waited, and the share of the processors' time that was idle at the end."""

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
    """Wait until the processors were idle enough for `WINDOW_S`, at most `LIMIT_S`."""
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
    """Idle and total time of all processors since boot, in the kernel's ticks; Linux only.

    Processes with a nice value above 0, which give way to others, count as idle; time that a hypervisor gave to other
    machines counts as busy.
    """
    ticks = read_ticks(path)
    return ticks.nice + ticks.idle + ticks.iowait, sum(ticks)
