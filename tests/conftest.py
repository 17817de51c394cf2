"""How tests share a machine: flights go one after another on one worker, and everything else beside them gives way."""

from __future__ import annotations

import fcntl
import os
import re
import sys
from collections.abc import Generator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from xdist import is_xdist_worker
from xdist.scheduler import LoadFileScheduling

sys.path.insert(0, str(Path(__file__).parent))
import lateness
import soak

# How long an example takes says how busy the machine is. The quick check tries fewer of them.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("quick", settings.get_profile("any machine"), max_examples=20)
settings.load_profile("any machine")

NICE, NICEST = 5, 10
"""Of tests beside flights: of those with brokers and processes, and of those that need nothing but time. More would
leave them no time on a machine that others load."""


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(lateness)
    config.pluginmanager.register(soak)


def _is_flight(item: pytest.Item) -> bool:
    return any(item.get_closest_marker(name) for name in ("alone", "e2e"))


def _is_alone(item: pytest.Item) -> bool:
    return item.get_closest_marker("alone") is not None


def _is_integration(item: pytest.Item) -> bool:
    return item.get_closest_marker("integration") is not None


def _order(item: pytest.Item) -> tuple[bool, bool, bool, bool]:
    """Flights first, those that are to be alone last of them; then what waits for others, whole files before what can
    be shared out; then what needs nothing but time.
    """
    return (
        not _is_flight(item),
        _is_alone(item),
        not _is_integration(item),
        item.get_closest_marker("apart") is not None,
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=_order)


class Scheduling(LoadFileScheduling):  # type: ignore[misc]
    """A worker takes file after file, one of them all flights; of a file marked `apart` each takes test after test."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        marks = _marks(self.config.rootpath / file)
        return "flights" if marks & {"alone", "e2e"} else nodeid if "apart" in marks else file


@cache
def _marks(file: Path) -> set[str]:
    """The marks that a file's text names: the process that shares out tests has not collected them."""
    return set(re.findall(r"pytest\.mark\.(\w+)", file.read_text()))


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> Scheduling:
    return Scheduling(config, log)


class Turn:
    """A lock of all workers: many have a share of it, or one has it alone, and whoever waits for that comes next."""

    def __init__(self, config: pytest.Config) -> None:
        self._door = os.open(config.rootpath, os.O_RDONLY)
        self._room = os.open(config.rootpath / "pyproject.toml", os.O_RDONLY)
        self._is_alone = False

    def share(self) -> None:
        self._take(fcntl.LOCK_SH)

    def take_alone(self) -> None:
        if not self._is_alone:
            self._take(fcntl.LOCK_EX)
            self._is_alone = True

    def leave(self) -> None:
        fcntl.flock(self._room, fcntl.LOCK_UN)
        self._is_alone = False

    def _take(self, how: int) -> None:
        """Who waits for the room keeps the door, and has left the room before."""
        self.leave()
        fcntl.flock(self._door, how)
        fcntl.flock(self._room, how)
        fcntl.flock(self._door, fcntl.LOCK_UN)


_turn: Turn | None = None
_has_flights = False


def pytest_collection_finish(session: pytest.Session) -> None:
    global _turn, _has_flights
    if is_xdist_worker(session):
        _turn = Turn(session.config)
        _has_flights = any(_is_flight(item) for item in session.items)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, object, object]:
    """Before the fixtures and the time limit of a test begin, its worker waits for its turn and gives way."""
    if _turn is None:
        return (yield)
    if _has_flights and not _is_flight(item):
        _give_way(NICE if _is_integration(item) else NICEST)
    if _is_alone(item) or lateness.is_again(item):
        _turn.take_alone()
    elif _is_integration(item) or _is_flight(item):
        _turn.share()
    try:
        return (yield)
    finally:
        if nextitem is None or not (_is_alone(item) and _is_alone(nextitem)):
            _turn.leave()


def _give_way(nice: int) -> None:
    """Never back: what comes later in the order needs to give way no less."""
    os.setpriority(os.PRIO_PROCESS, 0, max(nice, os.getpriority(os.PRIO_PROCESS, 0)))
