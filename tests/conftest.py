"""How tests share a machine: no example has a time limit, and of several workers the last has what is to be alone."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Generator

import pytest
from hypothesis import HealthCheck, settings
from xdist import is_xdist_worker

# How long an example takes says how busy the machine is.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")
_turn: int | None = None
"""A worker's lock: each shares it until it has nothing left to do; who has the tests that run alone waits for that."""


def _is_alone(item: pytest.Item) -> bool:
    return any(item.get_closest_marker(name) for name in ("alone", "e2e"))


def _place(item: pytest.Item) -> tuple[bool, bool, bool]:
    is_grouped, waits = (item.get_closest_marker(name) is not None for name in ("xdist_group", "integration"))
    return _is_alone(item), not is_grouped, not waits


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The long begin first, the quick ones fill what is left, and one worker gets all that run alone at the end."""
    items.sort(key=_place)
    for item in filter(_is_alone, items):
        item.add_marker(pytest.mark.xdist_group("alone"))


def pytest_collection_finish(session: pytest.Session) -> None:
    global _turn
    if is_xdist_worker(session):
        _turn = os.open(session.config.rootpath / "pyproject.toml", os.O_RDONLY)
        fcntl.flock(_turn, fcntl.LOCK_SH)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Before its fixtures and its time limit begin, a test that runs alone waits for the other workers."""
    if _turn is not None and _is_alone(item):
        fcntl.flock(_turn, fcntl.LOCK_EX)
    return (yield)


def pytest_sessionfinish() -> None:
    if _turn is not None:
        fcntl.flock(_turn, fcntl.LOCK_UN)
