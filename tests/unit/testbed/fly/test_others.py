"""The processors' time that other programs took, on processors that are made up."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.fly.others import TICKS_PER_S, Others, busy_and_total_s


def test_interrupts_and_waiting_are_nobodys_and_the_hypervisors_time_is_others(tmp_path: Path) -> None:
    stat = tmp_path / "stat"
    stat.write_text(
        "cpu  {} {} {} {} {} {} {} {} 0 0\ncpu0 1\n".format(*(n * TICKS_PER_S for n in (10, 1, 5, 70, 4, 2, 3, 5)))
    )
    assert busy_and_total_s(stat) == (21, 100)


@pytest.mark.parametrize(("fleet_s", "share"), [(30.0, 0.5), (80.0, 0.0), (81.0, 0.0)])
def test_the_fleets_own_time_is_not_others(fleet_s: float, share: float) -> None:
    """Docker counts more precisely than the kernel's ticks: a fleet alone may seem to have taken more than all."""
    times = iter([(1000.0, 5000.0), (1080.0, 5100.0)])
    assert Others(lambda: next(times)).share(fleet_s) == share
