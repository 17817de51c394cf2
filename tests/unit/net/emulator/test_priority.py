"""The emulator is as urgent as it may be, and says how urgent that is."""

from __future__ import annotations

import os

import pytest

from net.emulator.priority import raise_priority


def _refuse(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def _allow(*_: object) -> None:
    pass


@pytest.mark.parametrize(
    ("real_time", "nice", "said"),
    [(_allow, _allow, "fifo"), (_refuse, _allow, "nice -15"), (_refuse, _refuse, "none")],
)
def test_real_time_before_a_nice_value_before_nothing(
    monkeypatch: pytest.MonkeyPatch, real_time: object, nice: object, said: str
) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", real_time)
    monkeypatch.setattr(os, "setpriority", nice)
    assert raise_priority() == said
