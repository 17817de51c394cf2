"""What the model measures: plausible over a day, and the same for the same seed and time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sensor.model import QUANTITIES, noise, value

DAY_MS = 86_400_000
MIDSUMMER_MS = 1_782_000_000_000 // DAY_MS * DAY_MS
HOUR_MS = 3_600_000
KINDS = sorted(QUANTITIES)


@given(kind=st.sampled_from(KINDS), unix_ms=st.integers(0, 4 * 10**12), seed=st.integers())
def test_values_stay_within_their_bounds_and_decimals(kind: str, unix_ms: int, seed: int) -> None:
    quantity = QUANTITIES[kind]
    found = value(kind, unix_ms, seed)
    assert quantity.low <= found <= quantity.high
    assert found == round(found, quantity.decimals)


@given(second=st.integers(0, 4 * 10**9), seed=st.integers())
def test_noise_is_bounded_and_much_like_the_second_before(second: int, seed: int) -> None:
    here, before = noise("light", second, seed), noise("light", second - 1, seed)
    assert abs(here) <= 1
    assert abs(here - 0.9 * before) <= 0.1 + 1e-2


def test_the_same_seed_and_time_measure_the_same_and_another_seed_does_not() -> None:
    times = range(MIDSUMMER_MS, MIDSUMMER_MS + 60_000, 777)
    first = [value("temperature", unix_ms, 1) for unix_ms in times]
    noise.cache_clear()
    assert [value("temperature", unix_ms, 1) for unix_ms in times] == first
    assert [value("temperature", unix_ms, 2) for unix_ms in times] != first


@pytest.mark.parametrize("kind", KINDS)
def test_a_value_does_not_jump_from_one_millisecond_to_the_next(kind: str) -> None:
    quantity = QUANTITIES[kind]
    finest = 10**-quantity.decimals
    for second in range(20):
        edge_ms = MIDSUMMER_MS + 12 * HOUR_MS + second * 1000
        step = value(kind, edge_ms, 1) - value(kind, edge_ms - 1, 1)
        assert abs(step) <= finest + quantity.noise / 100


def test_noon_is_bright_nights_are_dark_and_afternoons_are_warm_and_dry() -> None:
    night, noon = MIDSUMMER_MS, MIDSUMMER_MS + 12 * HOUR_MS
    before_dawn, afternoon = MIDSUMMER_MS + 3 * HOUR_MS, MIDSUMMER_MS + 15 * HOUR_MS
    assert value("light", night, 1) < 1000 < 40_000 < value("light", noon, 1)
    assert value("temperature", before_dawn, 1) + 10 < value("temperature", afternoon, 1)
    assert value("humidity", afternoon, 1) + 30 < value("humidity", before_dawn, 1)
