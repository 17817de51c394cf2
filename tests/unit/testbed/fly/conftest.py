"""Series without Docker."""

from __future__ import annotations

import pytest

from testbed.fly import manifest, resume, runner
from testbed.fly.campaign import worker
from tests.handmade.made_up_fleet import CALIBRATED, HERE


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Links are as planned, and what is here is a revision without changes."""
    monkeypatch.setattr(runner, "calibrate", lambda *_: CALIBRATED)
    for module in (manifest, resume, worker):
        monkeypatch.setattr(module, "revision", lambda: HERE)
