"""Jitter has netem's distribution at every instant, and is the same whoever asks how often."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from net.emulator.jitter import CUT, SLOT_JITTERS, make_jitter, quantile

DISTRIBUTIONS = ("normal", "uniform", "pareto")
JITTER_NS = 5_000_000
KOLMOGOROV_999 = 1.95
"""Of the Kolmogorov-Smirnov distance times the square root of the number of independent values, 99.9 % lie below."""


def distance(values: np.ndarray, distribution: str) -> float:
    """Of Kolmogorov and Smirnov, to the distribution in units of the jitter."""
    shares = (np.arange(2000) + 0.5) / 2000
    expected = np.array([quantile(distribution, share) for share in shares])
    found = np.searchsorted(np.sort(values), expected, side="right") / len(values)
    inside = np.abs(expected) < CUT - 1e-3
    return float(np.max(np.abs(found - shares)[inside]))


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("reordering", [False, True])
def test_the_distribution_is_the_one_asked_for(distribution: str, reordering: bool) -> None:
    jitter = make_jitter(distribution, JITTER_NS, reordering, seed=3, name="air:uav1:up")
    slots = 8000
    step_ns = SLOT_JITTERS[distribution] * JITTER_NS * 0.61803  # anywhere in a slot, and mostly not in the one before
    values = np.array([jitter(int(number * step_ns)) for number in range(slots)]) / JITTER_NS
    assert distance(values, distribution) < KOLMOGOROV_999 / math.sqrt(slots / 2)  # neighbours depend on each other


@pytest.mark.parametrize(
    ("distribution", "mean", "deviation"),
    [("normal", 0, 1), ("uniform", 0, 1 / math.sqrt(3)), ("pareto", -0.033, 0.821)],
)
def test_quantiles_have_the_moments_of_netems_tables(distribution: str, mean: float, deviation: float) -> None:
    values = np.array([quantile(distribution, (number + 0.5) / 4096) for number in range(4096)])
    assert values.mean() == pytest.approx(mean, abs=0.02)
    assert values.std() == pytest.approx(deviation, rel=0.02)
    assert np.abs(values).max() <= CUT


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_a_frame_hardly_ever_has_to_wait_for_one_that_came_before(distribution: str) -> None:
    jitter = make_jitter(distribution, JITTER_NS, False, seed=5, name="wan:gs:up")
    times = np.arange(0, 20_000_000_000, 100_000)
    leaving = times + np.array([jitter(int(time)) for time in times])
    waited = np.maximum.accumulate(leaving) - leaving
    assert (waited > 0).mean() < 0.01
    assert waited.mean() < 0.002 * JITTER_NS


@settings(deadline=None)  # the first of each seed makes its table
@given(
    seed=st.integers(0, 2**64 - 1),
    times=st.lists(st.integers(0, 10**13), min_size=1, max_size=20),
    distribution=st.sampled_from(DISTRIBUTIONS),
    reordering=st.booleans(),
)
def test_it_depends_on_seed_and_time_alone(seed: int, times: list[int], distribution: str, reordering: bool) -> None:
    busy = make_jitter(distribution, JITTER_NS, reordering, seed % 4, "wan:gs:up")
    quiet = make_jitter(distribution, JITTER_NS, reordering, seed % 4, "wan:gs:up")
    found = [busy(time) for time in times]
    assert quiet(times[-1]) == found[-1]
    assert all(abs(value) <= CUT * JITTER_NS for value in found)


def test_links_and_seeds_have_jitters_of_their_own() -> None:
    made = [
        make_jitter("normal", JITTER_NS, False, seed, name)
        for seed, name in ((1, "air:uav1:up"), (1, "air:uav2:up"), (2, "air:uav1:up"))
    ]
    values = np.array([[jitter(number * 10 * JITTER_NS) for number in range(2000)] for jitter in made])
    assert np.abs(np.corrcoef(values) - np.eye(3)).max() < 0.1
