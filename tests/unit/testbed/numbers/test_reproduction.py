"""Intervals over paired attempts and the verdicts by them, with answers that one can work out by hand."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.numbers.observed import observe
from testbed.numbers.reproduction import (
    NOT_REPRODUCED,
    REPRODUCED,
    UNDECIDED,
    JudgedLine,
    estimate,
    judge,
    paired_ratios,
    verdict_of,
)
from testbed.plan.experiments import make_plan
from testbed.plan.headline import HeadlineCell, HeadlineLine
from tests.examples import examples
from tests.handmade.both_sides import entry, failed

SEED = 7


def _judged(points: dict[str, list[float]], of: str = "ratio", margin: tuple[float, float] = (1, 3)) -> JudgedLine:
    """A line about packets; a protocol's `points` by attempt from 1 on."""
    attempts = max(map(len, points.values()))
    sides = {
        protocol: {"attempts": [entry(protocol, n, packets=v) for n, v in enumerate(values, 1)], "void": []}
        for protocol, values in points.items()
    }
    return _judge(sides, of, margin, attempts)


def _judge(
    sides: dict[str, Any], of: str, margin: tuple[float, float], attempts: int, key: str = "packets"
) -> JudgedLine:
    cell = HeadlineCell(make_plan("scenario-1", str(attempts)), (HeadlineLine(key, of, margin[0], margin, "a guess"),))
    (found,) = judge(cell, observe(sides), SEED)
    return found


def test_the_mean_of_ratios_is_geometric_and_that_of_values_is_not() -> None:
    ratios = estimate([1.0, 4.0, 2.0], SEED, ratios=True)
    assert ratios is not None
    assert ratios.value == pytest.approx(2.0)
    assert 1.0 <= ratios.low < ratios.value < ratios.high <= 4.0
    values = estimate([1.0, 4.0, 4.0], SEED)
    assert values is not None
    assert values.value == 3.0


def test_the_edges_are_those_of_the_resampled_means() -> None:
    """Of three points one resample in 27 is the least one three times, more than 2.5 %: the edges are the extremes."""
    found = estimate([1.0, 2.0, 3.0], SEED)
    assert found is not None
    assert (found.low, found.high) == (1.0, 3.0)


def test_equal_values_have_an_interval_of_one_point() -> None:
    found = estimate([2.0] * 5, SEED, ratios=True)
    assert found is not None
    assert (found.value, found.low, found.high) == (2.0, 2.0, 2.0)
    nothing_lost = estimate([0.0] * 5, SEED)
    assert nothing_lost is not None
    assert (nothing_lost.low, nothing_lost.high) == (0.0, 0.0)


@pytest.mark.parametrize("points", [[], [1.0], [1.0, 2.0]])
def test_of_fewer_than_three_attempts_there_is_no_interval(points: list[float]) -> None:
    assert estimate(points, SEED) is None


def test_the_same_seed_gives_the_same_interval_and_another_one_another() -> None:
    points = [1.0, 1.7, 2.9, 4.1, 8.3, 9.7, 11.3]
    assert estimate(points, 1) == estimate(points, 1) != estimate(points, 2)


@examples(100)
@given(st.lists(st.floats(0.01, 1e6), min_size=3, max_size=9), st.integers(0, 2**31))
def test_an_interval_lies_within_the_points_and_around_their_mean(points: list[float], seed: int) -> None:
    found = estimate(points, seed, ratios=True)
    assert found is not None
    assert min(points) * 0.999999 <= found.low <= found.value * 1.000001
    assert found.value * 0.999999 <= found.high <= max(points) * 1.000001


def test_turned_round_the_ratios_turn_the_interval_round() -> None:
    points = [1.5, 2.0, 2.5, 4.0, 3.0]
    found = estimate(points, SEED, ratios=True)
    turned = estimate([1 / point for point in points], SEED, ratios=True)
    assert found is not None
    assert turned is not None
    assert (1 / turned.value, 1 / turned.high, 1 / turned.low) == pytest.approx((found.value, found.low, found.high))


def test_only_attempts_of_both_have_a_ratio_and_nothing_is_divided_by_zero() -> None:
    assert paired_ratios({1: 4.0, 2: 6.0, 3: 8.0, 4: 0.0}, {1: 2.0, 3: 0.0, 4: 1.0, 5: 1.0}) == {1: 2.0}


@pytest.mark.parametrize(
    ("mavlink", "verdict"),
    [
        ([200, 210, 190], REPRODUCED),
        ([400, 410, 390], NOT_REPRODUCED),
        ([40, 41, 39], NOT_REPRODUCED),
        ([250, 310, 350], UNDECIDED),
        ([90, 100, 120], UNDECIDED),
        ([100, 200, 300], REPRODUCED),  # an edge belongs to the margin
        ([200], UNDECIDED),
    ],
)
def test_a_verdict_is_where_the_interval_lies(mavlink: list[float], verdict: str) -> None:
    assert _judged({"mavlink": mavlink, "mqttxt": [100.0] * len(mavlink)}).verdict == verdict


def test_a_pair_that_lacks_one_side_is_named() -> None:
    sides = {
        "mqttxt": {"attempts": [entry("mqttxt", n) for n in (1, 2, 3, 4, 5)], "void": []},
        "mavlink": {"attempts": [*(entry("mavlink", n) for n in (1, 3)), failed("mavlink", "?", 4)], "void": []},
    }
    found = _judge(sides, "ratio", (0, 9_999), 5)
    assert (list(found.points), found.missing, found.verdict) == ([1, 3], (2, 4, 5), UNDECIDED)


def test_a_failed_attempt_counts_against_success() -> None:
    sides = {"mqttxt": {"attempts": [*(entry("mqttxt", n) for n in (1, 2)), failed("mqttxt", "?", 3)], "void": []}}
    found = _judge(sides, "mqttxt", (1, 1), 3, "success")
    assert found.points == {1: 1.0, 2: 1.0, 3: 0.0}
    assert found.verdict == UNDECIDED
    all_failed = {"mqttxt": {"attempts": [failed("mqttxt", "?", n) for n in (1, 2, 3)], "void": []}}
    assert _judge(all_failed, "mqttxt", (1, 1), 3, "success").verdict == NOT_REPRODUCED


def test_a_protocol_that_was_not_flown_decides_nothing() -> None:
    found = _judge({"mqttxt": {"attempts": [entry("mqttxt")], "void": []}}, "mavlink", (0, 1), 1)
    assert (found.points, found.missing, found.verdict) == ({}, (1,), UNDECIDED)


def test_attempts_beyond_those_asked_for_do_not_count() -> None:
    sides = {"mqttxt": {"attempts": [entry("mqttxt", n) for n in range(1, 6)], "void": []}}
    assert list(_judge(sides, "mqttxt", (0, 1), 3).points) == [1, 2, 3]


def test_one_line_that_is_not_reproduced_decides_and_one_undecided_leaves_open() -> None:
    inside, outside, across = (
        _judged({"mavlink": found, "mqttxt": [100.0] * 3}) for found in ([200] * 3, [900] * 3, [250, 310, 350])
    )
    assert verdict_of([inside, inside]) == REPRODUCED
    assert verdict_of([inside, across]) == UNDECIDED
    assert verdict_of([across, outside, inside]) == NOT_REPRODUCED
    assert verdict_of([]) == UNDECIDED
