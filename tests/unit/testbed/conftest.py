"""No test waits for a quiet machine."""

import pytest

from testbed.fly import runner
from testbed.fly.quiet import Waited


@pytest.fixture(autouse=True)
def waits(monkeypatch: pytest.MonkeyPatch) -> list[Waited]:
    """How often a run waited until the machine was quiet, which it is at once."""
    found: list[Waited] = []

    def wait() -> Waited:
        found.append(Waited(2.0, 0.9))
        return found[-1]

    monkeypatch.setattr(runner, "wait_for_quiet", wait)
    return found
