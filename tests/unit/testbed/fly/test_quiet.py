"""Waiting for a quieter moment of the machine, on a clock and processors that are made up."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.fly.quiet import LIMIT_S, WINDOW_S, Waited, processor_times, wait_for_quiet


class Machine:
    """Processors that are idle in these shares, window after window; the last of them goes on."""

    def __init__(self, *idle: float) -> None:
        self._shares = list(idle)
        self._times = (0, 0)
        self.now_s = 0.0

    def look(self) -> tuple[int, int]:
        return self._times

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        share = self._shares.pop(0) if len(self._shares) > 1 else self._shares[0]
        idle, total = self._times
        self._times = idle + int(share * 1000), total + 1000

    def wait(self) -> Waited:
        return wait_for_quiet(self.look, self.sleep, lambda: self.now_s)


def test_a_quiet_machine_costs_one_window() -> None:
    assert Machine(0.8).wait() == Waited(WINDOW_S, 0.8)


def test_it_goes_on_as_soon_as_the_last_window_was_quiet() -> None:
    found = Machine(0.1, 0.3, 0.59, 0.6).wait()
    assert found == Waited(4 * WINDOW_S, 0.6)
    assert found.is_quiet


def test_it_does_not_wait_for_ever() -> None:
    found = Machine(0.2).wait()
    assert found == Waited(LIMIT_S, 0.2)
    assert not found.is_quiet


def test_idle_time_is_what_no_other_machine_had_and_no_program_but_those_that_give_way(tmp_path: Path) -> None:
    stat = tmp_path / "stat"
    stat.write_text("cpu  10 1 5 70 4 2 3 5 0 0\ncpu0 10 1 5 70 4 2 3 5 0 0\nintr 5\n")
    assert processor_times(stat) == (75, 100)


def test_this_machine_can_be_looked_at() -> None:
    pytest.importorskip("resource")
    idle, total = processor_times()
    assert 0 <= idle <= total
