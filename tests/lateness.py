"""Tests that fly or measure times, on a machine that is late: flown again, and inconclusive where it stays late.

A process beside the tests sleeps in short steps and writes down when it woke up late: that is the machine's doing, not
the code's. Where a test marked `alone`, `e2e` or `timed` fails by what lateness may cause, and the machine was late
while it ran, the test is run anew with all its fixtures, once the machine is quieter, TURNS times at most. After that
it is neither passed nor failed but inconclusive, which the last lines say. Any other failure is one at once.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol

MARKS = ("alone", "e2e", "timed")
TURNS = 3
LATE_MS = 25
"""A process that sleeps and is not run for so long after: a machine with a core to spare is late by one or two."""
QUIET_S, PATIENCE_S = 5.0, 60.0
CAUSED = (AssertionError, TimeoutError, subprocess.TimeoutExpired, pytest.fail.Exception)
"""What lateness may cause: that something was not so, or not in time."""
_TURN, _MAY_BE = pytest.StashKey[int](), pytest.StashKey[bool]()
_SLEEPER = f"""
import select, sys, time
while True:
    began = time.monotonic()
    if select.select([sys.stdin], [], [], 0.01)[0]:
        break
    now = time.monotonic()
    if now - began > 0.01 + {LATE_MS} / 1000:
        print(now, round((now - began - 0.01) * 1000), flush=True)
"""


class Watch:
    """The process that sleeps; it ends with this one."""

    def __init__(self) -> None:
        number, path = tempfile.mkstemp()
        self._file = Path(path)
        self._process = subprocess.Popen([sys.executable, "-c", _SLEEPER], stdin=subprocess.PIPE, stdout=number)
        os.close(number)

    def late_ms(self, since_s: float) -> int:
        """How late it was at worst since a moment of time.monotonic(), 0 where it never was by more than LATE_MS."""
        whole, _, _ = self._file.read_text().rpartition("\n")  # a line may be half written yet
        lines = [line.split() for line in whole.splitlines()]
        return max((int(late) for at, late in lines if float(at) >= since_s), default=0)

    def wait_for_quiet(self) -> None:
        began_s = time.monotonic()
        while self.late_ms(time.monotonic() - QUIET_S) and time.monotonic() < began_s + PATIENCE_S:
            time.sleep(1)

    def end(self) -> None:
        self._process.communicate()
        self._file.unlink()


_watch: Watch | None = None


def _watching() -> Watch:
    global _watch
    _watch = _watch or Watch()
    return _watch


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.failed and call.excinfo is not None:
        item.stash[_MAY_BE] = item.stash.get(_MAY_BE, True) and isinstance(call.excinfo.value, CAUSED)
    return report


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> object:
    if not any(item.get_closest_marker(name) for name in MARKS):
        return None
    watch, began_s = _watching(), time.monotonic()
    turn = item.stash.get(_TURN, 1)
    item.stash[_MAY_BE] = True
    if turn == 1:
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports = runtestprotocol(item, nextitem=nextitem, log=False)
    failed = [report for report in reports if report.failed]
    late_ms = watch.late_ms(began_s) if failed and item.stash[_MAY_BE] else 0
    if late_ms and turn < TURNS:
        over = pytest.CallInfo.from_call(lambda: item.session._setupstate.teardown_exact(None), "teardown")
        if over.excinfo is None:
            item.stash[_TURN] = turn + 1
            item.ihook.pytest_timeout_cancel_timer(item=item)  # the next turn has its own
            watch.wait_for_quiet()
            item.ihook.pytest_runtest_protocol(item=item, nextitem=nextitem)
            return True
        reports.append(item.ihook.pytest_runtest_makereport(item=item, call=over))
    elif late_ms:
        for report in failed:
            _make_inconclusive(report, item, late_ms)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _make_inconclusive(report: pytest.TestReport, item: pytest.Item, late_ms: int) -> None:
    path, line, _ = item.location
    loads = " ".join(f"{load:.0f}" for load in os.getloadavg())
    reason = f"the machine was {late_ms} ms late, and late in each of {TURNS} turns; its load is {loads}"
    report.sections.append(("what failed in the last turn", report.longreprtext))
    report.outcome, report.longrepr = "skipped", (path, (line or 0) + 1, reason)
    report.inconclusive = reason


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, tuple[str, dict[str, bool]]] | None:
    if hasattr(report, "inconclusive"):
        return "inconclusive", "I", ("INCONCLUSIVE", {"yellow": True})
    return None


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """With what failed, for nobody sees it otherwise."""
    for report in terminalreporter.stats.get("inconclusive", []):
        terminalreporter.section(f"INCONCLUSIVE {report.nodeid}", yellow=True)
        terminalreporter.line(report.sections[-1][1])
        terminalreporter.line(f"INCONCLUSIVE {report.nodeid}: {report.inconclusive}", yellow=True)


def pytest_sessionfinish() -> None:
    if _watch is not None:
        _watch.end()
