"""The comparison's statistics tell what differs from what does not, and say so by chance as seldom as they claim."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from tests.shapers import statistics
from tests.shapers.comparison import LATE_MS
from tests.shapers.rounds import SAMPLE
from tests.shapers.statistics import beyond, ks_distance, ks_limit, mean_limit, overtaken, share_limit


def test_the_distance_is_the_greatest_difference_of_shares() -> None:
    assert ks_distance([1, 2, 3, 4], [1, 2, 3, 4]) == 0
    assert ks_distance([1, 2, 3, 4], [3, 4, 5, 6]) == 0.5
    assert ks_distance([1, 1], [2, 2]) == 1


def test_slack_forgives_what_is_a_little_later_and_nothing_else() -> None:
    same = [50.0] * 10
    late = [50.1] * 10
    assert ks_distance(same, late) == ks_distance(late, same) == 1
    assert ks_distance(same, late, 0.2) == ks_distance(late, same, 0.2) == 0
    assert ks_distance(same, late[:5] + [60.0] * 5, 0.2) == 0.5


def test_limits_are_exceeded_as_seldom_as_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statistics, "CHANCE", 0.01)
    monkeypatch.setattr(statistics, "DEVIATIONS", 2.576)
    draw, size, rounds = np.random.default_rng(3), 300, 600
    ones, others = draw.normal(size=(rounds, size)), draw.normal(size=(rounds, size))
    pairs = list(zip(ones, others, strict=True))
    most = rounds * 0.01 + 4 * math.sqrt(rounds * 0.01)
    assert sum(ks_distance(a.tolist(), b.tolist()) > ks_limit(size, size) for a, b in pairs) <= most
    assert sum(abs(a.mean() - b.mean()) > mean_limit(1.0, size, size) for a, b in pairs) <= most
    shares = [((a > 1).mean(), (b > 1).mean()) for a, b in pairs]
    assert sum(abs(a - b) > share_limit((a + b) / 2, size, size) for a, b in shares) <= most


def test_a_mean_that_is_off_by_a_few_percent_is_seen_in_the_samples_that_are_taken() -> None:
    draw = random.Random(1)
    ours = [draw.gauss(40, 4) for _ in range(SAMPLE)]
    others = [draw.gauss(42, 4) for _ in range(SAMPLE)]
    assert ks_distance(ours, others, LATE_MS) > ks_limit(SAMPLE, SAMPLE)


def test_another_distribution_of_the_same_deviation_is_seen_beyond_it() -> None:
    draw = random.Random(1)
    ours = [draw.gauss(40, 4) for _ in range(SAMPLE)]
    others = [draw.uniform(40 - 4 * math.sqrt(3), 40 + 4 * math.sqrt(3)) for _ in range(SAMPLE)]
    shares = [beyond(values, 1.8 * 4) for values in (ours, others)]
    assert abs(shares[0] - shares[1]) > share_limit(sum(shares) / 2, SAMPLE, SAMPLE)


def test_who_comes_after_a_later_one_was_overtaken() -> None:
    assert overtaken([0, 1, 2, 3]) == 0
    assert overtaken([1, 2, 0, 3]) == 1
    assert overtaken([3, 0, 1, 2]) == 3
