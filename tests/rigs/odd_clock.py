"""Runs mqttxt with clocks that are not the machine's: python odd_clock.py PPM ARGUMENT…

The session clock runs faster by PPM millionths, and SIGUSR1 steps it ahead by `STEP_MS`. The wall clock is wrong by
an hour, in one direction or the other, from second to second.
"""

from __future__ import annotations

import runpy
import signal
import sys
import time

STEP_MS = 3000


def main() -> None:
    ppm = int(sys.argv.pop(1))
    from mqttxt.core import clock

    true_ns, wall_s = clock.system_clock_ns, time.time
    start_ns = true_ns()
    steps: list[int] = []

    def session_ns() -> int:
        return start_ns + (true_ns() - start_ns) * (1_000_000 + ppm) // 1_000_000 + len(steps) * STEP_MS * 1_000_000

    signal.signal(signal.SIGUSR1, lambda number, frame: steps.append(number))
    clock.system_clock_ns = session_ns
    clock.SessionClock.__init__.__defaults__ = (session_ns, None)
    time.time = lambda: wall_s() + (3600 if int(wall_s()) % 2 else -3600)
    runpy.run_module("mqttxt", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
