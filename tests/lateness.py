"""Tests on a late machine are run again; those that fly or measure times are inconclusive if it stays late.

A process beside the tests (sleeper.py) sleeps in short steps and records when it woke up late: that is the machine's
doing, not the code's.

A test is run again if it fails in a way that lateness may cause, and the machine was late while the test ran or
while one of its fixtures was set up (even for an earlier test of the file); or if its flight is Void. It then runs with
new fixtures, at most TURNS times: a worker's tests do so once it has no others left, beside no tests but those that
give way (workers.py), and hold nobody up until then. A test with one of MARKS waits until the machine is quieter, and
after its last turn it is neither passed nor failed but inconclusive: the last lines name it with its failure, and the
very last one counts it. Any other test that fails in every turn has failed. A failure that lateness cannot cause counts
at once.

The sleeper does not see delays by a container or a disk. So a test with one of MARKS that fails beside others, in a way
that lateness may cause, gets a second turn alone even if no lateness was seen. One of the last lines names the failure
of the first.
"""

from __future__ import annotations

import math
import os
import subprocess
import time
from collections.abc import Generator, Sequence
from pathlib import Path
from weakref import WeakKeyDictionary

import pytest
from _pytest.runner import runtestprotocol
from xdist import is_xdist_worker

from mqttxt import errors
from tests.sleeper import Span, Watch

MARKS = ("alone", "e2e", "integration")
"""The marks of tests that fly or measure times."""
TURNS = 3
AGAIN = "again"
"""The outcome of a turn after which a test is put off."""
CAUSED = (
    AssertionError,
    OSError,
    subprocess.SubprocessError,
    pytest.fail.Exception,
    errors.FogUnreachable,
    errors.TransferFailed,
    errors.TransportError,
)
"""Errors that lateness may cause: a condition that does not hold, or something too late or not there yet."""
Failures = Sequence[pytest.ExceptionInfo[BaseException]]
_TURN = pytest.StashKey[int]()
_BESIDE = pytest.StashKey[str]()
"""The failure beside other tests, on a machine that was not late."""
_ERRORS, _PLACES = pytest.StashKey[list[pytest.ExceptionInfo[BaseException]]](), pytest.StashKey[set[str]]()
"""The failures of this turn, and their places in all turns."""


def is_again(item: pytest.Item) -> bool:
    """Whether a test is in a further turn."""
    return item.stash.get(_TURN, 1) > 1


def is_flight(item: pytest.Item) -> bool:
    return any(item.get_closest_marker(name) for name in ("alone", "e2e"))


class Void(Exception):
    """A flight that does not count, with the reason: the testbed's verdict, which sees lateness that the sleeper does
    not.
    """


_watch: Watch | None = None


def watching() -> Watch:
    global _watch
    _watch = _watch or Watch()
    return _watch


_set_up = WeakKeyDictionary[pytest.FixtureDef[object], Span]()
"""When each fixture was set up last."""


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[object]) -> Generator[None, object, object]:
    began_s = time.monotonic()
    try:
        return (yield)
    finally:
        _set_up[fixturedef] = (began_s, time.monotonic())


_judged: list[tuple[BaseException, str]] = []
"""Failures of last turns, and their causes: a file-wide fixture raises the same failure again in the next test."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.failed and call.excinfo is not None:
        item.stash.setdefault(_ERRORS, []).append(call.excinfo)
    return report


_later: list[pytest.Item] = []
"""Tests of this worker that run again once it has no others left."""
_not_set_up: set[Path] = set()
"""The files of those that fly and were not set up: the other tests of such a file wait with them for its flight."""
_awaited: dict[str, None] = {}
"""The names of tests that were put off and have not run again yet."""


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> object:
    is_timed = _is_timed(item)
    watch, began_s = watching(), time.monotonic()
    turn = item.stash.get(_TURN, 1)
    failures = item.stash[_ERRORS] = []
    if turn == 1:
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        if item.path in _not_set_up:
            # The test before left what this one has in common with it.
            item.session._setupstate.teardown_exact(nextitem)
            _put_off(item)
            return True
    reports = runtestprotocol(item, nextitem=nextitem, log=False)
    item.stash.setdefault(_PLACES, set()).update(_place(item, failure) for failure in failures[:1])
    known = _known_cause(failures)
    cause = known or (_cause(failures, watch.late_ms((began_s, math.inf), *_set_up_of(item))) if failures else None)
    is_beside_others = is_timed and turn == 1 and _has_others_beside(item)
    if cause is None and is_beside_others and failures and _may_be_caused(failures, CAUSED):
        item.stash[_BESIDE] = f"{_place(item, failures[0])}: {_first_line(failures[0])}"
    if known is None and ((cause is not None and turn < TURNS) or (_BESIDE in item.stash and turn == 1)):
        over = pytest.CallInfo.from_call(lambda: item.session._setupstate.teardown_exact(None), "teardown")
        if over.excinfo is None or _cause([over.excinfo], watch.late_ms((began_s, math.inf))) is not None:
            item.ihook.pytest_timeout_cancel_timer(item=item)  # the next turn has its own
            if not is_xdist_worker(item.session):
                item.stash[_TURN] = turn + 1
                _run_again(item, nextitem)
                return True
            if is_flight(item) and any(report.when == "setup" and report.failed for report in reports):
                _not_set_up.add(item.path)
            _put_off(item)
            return True
        reports.append(item.ihook.pytest_runtest_makereport(item=item, call=over))
    elif cause is not None and is_timed:
        _judged.extend((failure.value, cause) for failure in failures)
        for report in reports:
            if report.failed:
                _make_inconclusive(report, item, cause)
    for report in reports:
        if report.when == "call" and report.passed and _BESIDE in item.stash:
            report.beside_others = item.stash[_BESIDE]
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _put_off(item: pytest.Item) -> None:
    """Put a test off, and say to the process that distributes the tests that its reports are still to come."""
    item.stash[_TURN] = item.stash.get(_TURN, 1) + 1
    _later.append(item)
    report = pytest.TestReport(item.nodeid, item.location, {}, AGAIN, None, "teardown")  # type: ignore[arg-type]
    item.ihook.pytest_runtest_logreport(report=report)


def _run_again(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    if _is_timed(item):
        watching().wait_for_quiet()
    item.ihook.pytest_runtest_protocol(item=item, nextitem=nextitem)


@pytest.hookimpl(wrapper=True)
def pytest_runtestloop(session: pytest.Session) -> Generator[None, object, object]:
    """A worker that has no tests left runs those again that it put off."""
    done = yield
    while _later and not session.shouldfail and not session.shouldstop:
        item, *behind = _later
        del _later[0]
        worker = next(one for one in session.config.pluginmanager.get_plugins() if hasattr(one, "item_index"))
        worker.item_index = session.items.index(item)  # it names the test whose reports it sends
        _run_again(item, next(iter(behind), None))
    return done


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.outcome == AGAIN:
        _awaited[report.nodeid] = None
    else:
        _awaited.pop(report.nodeid, None)


def passes_alone(item: pytest.Item, failed: str | None) -> None:
    """Called by a test that passes because its fixture was repeated alone: `failed` is the failure beside others."""
    if failed is not None:
        item.stash[_BESIDE] = failed


def _is_timed(item: pytest.Item) -> bool:
    return any(item.get_closest_marker(name) for name in MARKS)


def _set_up_of(item: pytest.Item) -> list[Span]:
    """When the fixtures of a test were set up, including those of its file and of the whole run."""
    assert isinstance(item, pytest.Function)
    used = [found[-1] for found in item._fixtureinfo.name2fixturedefs.values()]
    return [_set_up[fixture] for fixture in used if fixture in _set_up]


def _has_others_beside(item: pytest.Item) -> bool:
    worker: dict[str, int] = getattr(item.config, "workerinput", {})
    return worker.get("workercount", 1) > 1


def _may_be_caused(failures: Failures, by: tuple[type[BaseException], ...]) -> bool:
    return all(isinstance(one, by) for failure in failures for one in _leaves(failure.value))


def _leaves(error: BaseException) -> list[BaseException]:
    """The exceptions of a group, as a task group raises it, or the exception itself."""
    return [leaf for one in error.exceptions for leaf in _leaves(one)] if hasattr(error, "exceptions") else [error]


def _cause(failures: Failures, late_ms: int) -> str | None:
    """The possible cause of all failures of a turn; None if one of them has another cause."""
    if not _may_be_caused(failures, (Void, *CAUSED) if late_ms else (Void,)):
        return None
    if any(isinstance(one, Void) for failure in failures for one in _leaves(failure.value)):
        return "what it flew was void"
    return f"the machine was late, in the last by {late_ms} ms"


def _known_cause(failures: Failures) -> str | None:
    """The cause of a failure that another test of the file has had in all its turns."""
    return next((cause for value, cause in _judged if [value] == [each.value for each in failures]), None)


def _place(item: pytest.Item, failure: pytest.ExceptionInfo[BaseException]) -> str:
    """The failing line of the test's own file, or, if none was reached, the line that raised."""
    entries = [entry for entry in failure.traceback if entry.path == item.path] or [failure.traceback[-1]]
    return f"{Path(entries[-1].path).name}:{entries[-1].lineno + 1}"


def _first_line(failure: pytest.ExceptionInfo[BaseException]) -> str:
    return failure.exconly(tryshort=True).partition("\n")[0]


def _make_inconclusive(report: pytest.TestReport, item: pytest.Item, cause: str) -> None:
    path, line, _ = item.location
    places = " and ".join(sorted(item.stash[_PLACES]))
    said = _first_line(item.stash[_ERRORS][0])
    loads = " ".join(f"{load:.0f}" for load in os.getloadavg())
    reason = f"{places}: {said}; in each of {TURNS} turns {cause}; the machine's load is {loads}"
    report.sections.append(("what failed in the last turn", report.longreprtext))
    report.outcome, report.longrepr = "skipped", (path, (line or 0) + 1, reason)
    report.inconclusive = reason


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, tuple[str, dict[str, bool]]] | None:
    if hasattr(report, "inconclusive"):
        return "inconclusive", "I", ("INCONCLUSIVE", {"yellow": True})
    return (AGAIN, "", ("", {})) if report.outcome == AGAIN else None


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> Generator[None, None, None]:
    """Print inconclusive tests among the failures, and a line for each after everything else, so that it is seen."""
    passed = terminalreporter.stats.get("passed", [])
    inconclusive = terminalreporter.stats.get("inconclusive", [])
    for report in inconclusive:
        terminalreporter.section(f"INCONCLUSIVE {report.nodeid}", yellow=True)
        terminalreporter.line(report.sections[-1][1])
    yield
    for report in passed:
        if hasattr(report, "beside_others"):
            terminalreporter.line(f"PASSED ALONE {report.nodeid}, beside others {report.beside_others}", yellow=True)
    for report in inconclusive:
        terminalreporter.line(f"INCONCLUSIVE {report.nodeid}: {report.inconclusive}", yellow=True)
    for nodeid in _awaited:
        terminalreporter.line(f"NOT RUN AGAIN {nodeid}: its worker ended", red=True)


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    if _awaited and not is_xdist_worker(session):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
    if _watch is not None:
        _watch.end()
