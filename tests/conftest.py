"""How tests share a machine: no example has a time limit, and of several workers the last has what is to be alone."""

from __future__ import annotations

import fcntl
import os
import sys
from collections.abc import Generator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from xdist import is_xdist_worker

sys.path.insert(0, str(Path(__file__).parent))
import lateness

# How long an example takes says how busy the machine is. The quick check tries fewer of them.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("quick", settings.get_profile("any machine"), max_examples=20)
settings.load_profile("any machine")


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(lateness)


_turn: int | None = None
"""A worker's lock: all share it until nothing is left for them but what is to be alone; then one has it at a time."""


def _is_alone(item: pytest.Item) -> bool:
    return any(item.get_closest_marker(name) for name in ("alone", "e2e"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The long begin first, the quick ones fill what is left, and what is to be alone is left for the end."""
    items.sort(key=lambda item: (_is_alone(item), item.get_closest_marker("integration") is None))


def pytest_collection_finish(session: pytest.Session) -> None:
    global _turn
    if is_xdist_worker(session):
        _turn = os.open(session.config.rootpath / "pyproject.toml", os.O_RDONLY)
        fcntl.flock(_turn, fcntl.LOCK_SH)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Before the fixtures and the time limit of a test that runs alone begin, its worker waits for the others."""
    if _turn is not None and _is_alone(item):
        fcntl.flock(_turn, fcntl.LOCK_EX)
    return (yield)


def pytest_sessionfinish() -> None:
    if _turn is not None:
        fcntl.flock(_turn, fcntl.LOCK_UN)
