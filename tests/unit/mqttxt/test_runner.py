"""The runner's schedule: a steady rate, whatever a tick takes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mqttxt.io.runner import TICK_S, next_tick


@given(st.floats(0, 1e6), st.floats(0, 60))
def test_the_next_tick_is_on_the_schedule_and_not_yet_past(due_s: float, late_s: float) -> None:
    now_s = due_s + late_s
    after = next_tick(due_s, now_s)
    ticks = (after - due_s) / TICK_S
    assert ticks == pytest.approx(round(ticks), abs=1e-6)
    assert round(ticks) >= 1
    assert now_s - 1e-6 <= after <= now_s + TICK_S + 1e-6


def test_a_tick_that_took_long_is_not_made_up_for_by_a_burst() -> None:
    assert next_tick(10.0, 10.001) == pytest.approx(10.05)
    assert next_tick(10.0, 10.26) == pytest.approx(10.30)
