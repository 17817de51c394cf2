"""How `make test` distributes tests: one worker flies, the others first run tests that wait, then all that compute."""

from __future__ import annotations

import faulthandler
import fcntl
import itertools
import math
import os
import re
from collections.abc import Generator, Sequence
from functools import cache
from pathlib import Path
from typing import TypeVar

import pytest
from _pytest.faulthandler import fault_handler_stderr_fd_key
from xdist import is_xdist_worker
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

from tests import lateness

NICE, NICEST = 5, 10
"""Nice values of tests beside flights: of those with brokers and processes, and of those that need nothing but time.
Higher ones would leave them no time on a machine under other load."""
PATIENCE = 2
"""A worker that is still in a test after this many of its time limits hangs: it prints its tracebacks, and ends."""
FLIGHTS = "flights"
One = TypeVar("One")


def _is_alone(item: pytest.Item) -> bool:
    return item.get_closest_marker("alone") is not None


def _is_integration(item: pytest.Item) -> bool:
    return item.get_closest_marker("integration") is not None


def _order(item: pytest.Item) -> tuple[bool, bool, bool, bool, float]:
    """Flights first, `alone` ones last among them; then integration tests, of the `apart` ones the longest first; then
    tests that need nothing but time.
    """
    is_apart = item.get_closest_marker("apart") is not None
    longest_first = -_limit_s(item) if is_apart else 0.0
    return not lateness.is_flight(item), _is_alone(item), not _is_integration(item), is_apart, longest_first


def mixed(files: Sequence[Sequence[One]], apart: Sequence[One]) -> list[One]:
    """The tests of whole files, those with the most tests first, with `apart` tests behind each, of which a third is
    left for the end: many of these files have a browser, and together they would leave no time to each other.
    """
    each = math.ceil(len(apart) * 2 / 3 / max(1, len(files)))
    largest_first = sorted(files, key=len, reverse=True)
    parts = [(*file, *apart[n * each : (n + 1) * each]) for n, file in enumerate(largest_first)]
    return [one for part in parts for one in part] + list(apart[len(files) * each :])


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=_order)
    shared = [item for item in items if _is_integration(item) and not lateness.is_flight(item)]
    if shared:
        whole = itertools.groupby((one for one in shared if not one.get_closest_marker("apart")), lambda one: one.path)
        begin, apart = items.index(shared[0]), [one for one in shared if one.get_closest_marker("apart")]
        items[begin : begin + len(shared)] = mixed([list(file) for _, file in whole], apart)


@cache
def _marks(file: Path) -> set[str]:
    """The marks named in a file's text: the process that distributes the tests has not collected them."""
    return set(re.findall(r"pytest\.mark\.(\w+)", file.read_text()))


class Lock:
    """A lock on a file that all workers share; it is released when its holder's process ends."""

    def __init__(self, file: Path) -> None:
        self._file = os.open(file, os.O_RDONLY)

    def share(self) -> None:
        fcntl.flock(self._file, fcntl.LOCK_SH)

    def take(self) -> None:
        fcntl.flock(self._file, fcntl.LOCK_EX)

    def leave(self) -> None:
        fcntl.flock(self._file, fcntl.LOCK_UN)


_ROOM = Path(__file__)
"""The lock of what runs beside each other: shared by each integration test and flight, and by the process that
distributes the tests while a worker other than the flying one has integration tests left; what is alone takes it."""


class Scheduling(LoadFileScheduling):  # type: ignore[misc]
    """A worker takes file after file, one worker all flights; tests of a file marked `apart` are taken one by one."""

    def schedule(self) -> None:
        if self.collection is None:
            self._lock = Lock(_ROOM)
            collected = next(iter(self.registered_collections.values()))
            self._left = {nodeid for nodeid in collected if self._is_integration(nodeid)}
            if self._left:  # else this run waits for no other one's flights
                self._lock.share()
            self._leave_once_none_is_left()
        super().schedule()

    def mark_test_complete(self, node: WorkerController, item_index: int, duration: float = 0) -> None:
        self._left.discard(self.registered_collections[node][item_index])
        self._leave_once_none_is_left()
        super().mark_test_complete(node, item_index, duration)

    def remove_node(self, node: WorkerController) -> str | None:
        """As xdist's own, except that the test that killed its worker is not run again: it would kill the next one.

        Nor are the units that are done shared out again: a worker that gets nothing but one of these waits for ever.
        """
        units = self.assigned_work[node]
        crashed = next((one for unit in units.values() for one, is_done in unit.items() if not is_done), None)
        if crashed is not None:
            units[self._split_scope(crashed)][crashed] = True
            self._left.discard(crashed)
        self.assigned_work[node] = {scope: unit for scope, unit in units.items() if not all(unit.values())}
        super().remove_node(node)
        if crashed is not None:
            self._leave_once_none_is_left()
        return crashed

    def _assign_work_unit(self, node: WorkerController) -> None:
        super()._assign_work_unit(node)
        self._leave_once_none_is_left()

    def _leave_once_none_is_left(self) -> None:
        """Release the lock once integration tests are left only behind the flights: those cannot wait for them."""
        flying = next((units for units in self.assigned_work.values() if FLIGHTS in units), {})
        behind = {nodeid for unit in flying.values() for nodeid in unit}
        if self._left <= behind or len(self.nodes) == 1:
            self._lock.leave()

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        marks = _marks(self.config.rootpath / file)
        return FLIGHTS if marks & {"alone", "e2e"} else nodeid if "apart" in marks else file

    def _is_integration(self, nodeid: str) -> bool:
        scope = self._split_scope(nodeid)
        return scope != FLIGHTS and "integration" in _marks(self.config.rootpath / nodeid.partition("::")[0])


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> Scheduling:
    return Scheduling(config, log)


class Turn:
    """What a worker waits for before a test: integration tests and flights share the room; what is alone or runs again
    has it to itself, once no integration test is left.
    """

    def __init__(self) -> None:
        self._room = Lock(_ROOM)

    def take(self, item: pytest.Item) -> None:
        if _is_alone(item) or lateness.is_again(item):
            self._room.take()
        elif _is_integration(item) or lateness.is_flight(item):
            self._room.share()

    def leave(self) -> None:
        self._room.leave()


_turn: Turn | None = None
_has_flights = False


def pytest_collection_finish(session: pytest.Session) -> None:
    global _turn, _has_flights
    if is_xdist_worker(session):
        _turn = Turn()
        _has_flights = any(lateness.is_flight(item) for item in session.items)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Wait for the worker's turn, and give way, before a test's fixtures and time limit begin."""
    if _turn is None:
        return (yield)
    if _has_flights and not lateness.is_flight(item):
        _give_way(NICE if _is_integration(item) else NICEST)
    faulthandler.cancel_dump_traceback_later()  # of the turn before
    _turn.take(item)
    stderr = item.config.stash[fault_handler_stderr_fd_key]
    faulthandler.dump_traceback_later(PATIENCE * _limit_s(item), file=stderr, exit=True)
    try:
        return (yield)
    finally:
        faulthandler.cancel_dump_traceback_later()
        _turn.leave()


def _limit_s(item: pytest.Item) -> float:
    mark = item.get_closest_marker("timeout")
    return float(mark.args[0] if mark else item.config.getini("timeout") or 120)


def _give_way(nice: int) -> None:
    """Raise the nice value, never lower it: later tests in the order give way at least as much."""
    own = os.getpriority(os.PRIO_PROCESS, 0)
    if nice > own:
        os.setpriority(os.PRIO_PROCESS, 0, nice)
        lateness.watching().give_way(nice)
