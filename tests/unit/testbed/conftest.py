"""No test waits for a quiet machine; a series that has no attempts yet."""

from pathlib import Path

import pytest

from testbed.fly import runner
from testbed.fly.quiet import Waited
from testbed.fly.results import Series, new_series


@pytest.fixture(autouse=True)
def waits(monkeypatch: pytest.MonkeyPatch) -> list[Waited]:
    """How often a run waited until the machine was quiet, which it is at once."""
    found: list[Waited] = []

    def wait() -> Waited:
        found.append(Waited(2.0, 0.9))
        return found[-1]

    monkeypatch.setattr(runner, "wait_for_quiet", wait)
    return found


@pytest.fixture
def series(tmp_path: Path) -> Series:
    return new_series(tmp_path, "scenario-1", "thesis", "ideal")
