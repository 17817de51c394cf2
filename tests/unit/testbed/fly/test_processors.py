"""The processors' time that other programs took, on processors that are made up."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.fly.processors import TICKS_PER_S, Others, Ticks, read_ticks


def test_interrupts_and_waiting_are_nobodys_and_the_hypervisors_time_is_others(tmp_path: Path) -> None:
    stat = tmp_path / "stat"
    stat.write_text("cpu  10 1 5 70 4 2 3 5 0 0\ncpu0 1\n")
    assert (read_ticks(stat).programs, sum(read_ticks(stat))) == (21, 100)


@pytest.mark.parametrize(("fleet", "share"), [(30, 0.5), (80, 0.0), (81, 0.0)])
def test_the_fleets_own_time_is_not_others(fleet: int, share: float) -> None:
    """Docker counts more precisely than the kernel's ticks: a fleet alone may seem to have taken more than all."""
    looks = iter([Ticks(1000, 0, 0, 4000, 0, 0, 0, 0), Ticks(1040, 10, 20, 4020, 0, 0, 0, 10)])
    assert Others(lambda: next(looks)).share(fleet / TICKS_PER_S) == share
