"""A process that sleeps beside the tests in short steps, and records when it woke up late."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LATE_MS = 25
"""Lateness that counts, in waking a sleeping process: on a machine with a core to spare it is one or two."""
QUIET_S, PATIENCE_S = 5.0, 60.0
Span = tuple[float, float]
"""Begin and end, by time.monotonic()."""
_SLEEPER = f"""
import os, select, sys, time
while True:
    began = time.monotonic()
    asked = os.read(0, 1) if select.select([0], [], [], 0.01)[0] else None
    if asked == b"":
        break
    now = time.monotonic()
    if asked or now - began > 0.01 + {LATE_MS} / 1000:
        print(began, now, max(0, round((now - began - 0.01) * 1000)), asked is not None, flush=True)
"""


class Watch:
    """The process that sleeps; it ends with this one."""

    def __init__(self) -> None:
        number, path = tempfile.mkstemp()
        self._file = Path(path)
        self._process = subprocess.Popen([sys.executable, "-c", _SLEEPER], stdin=subprocess.PIPE, stdout=number)
        os.close(number)
        self._asked = 0

    def late_ms(self, *spans: Span) -> int:
        """The greatest lateness that reaches into the spans, 0 if it was never more than LATE_MS.

        It waits for the sleeper: what delayed a test that has just ended may delay that still.
        """
        self._ask()
        found = [(float(began), float(at), int(late)) for began, at, late, _ in self._lines()]
        reaching = (late for began, at, late in found if any(began <= until and since <= at for since, until in spans))
        return max((late for late in reaching if late > LATE_MS), default=0)

    def _lines(self) -> list[list[str]]:
        whole, _, _ = self._file.read_text().rpartition("\n")  # a line may be half written yet
        return [line.split() for line in whole.splitlines()]

    def _ask(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(b"?")
        self._process.stdin.flush()
        self._asked += 1
        while sum(line[-1] == "True" for line in self._lines()) < self._asked:
            assert self._process.poll() is None, "the process that watches for lateness has ended"
            time.sleep(0.001)

    def wait_for_quiet(self) -> None:
        began_s = time.monotonic()
        while self.late_ms((time.monotonic() - QUIET_S, math.inf)) and time.monotonic() < began_s + PATIENCE_S:
            time.sleep(1)

    def give_way(self, nice: int) -> None:
        """Give the sleeper the nice value of the tests that it watches for."""
        os.setpriority(os.PRIO_PROCESS, self._process.pid, nice)

    def end(self) -> None:
        self._process.communicate()
        self._file.unlink()
