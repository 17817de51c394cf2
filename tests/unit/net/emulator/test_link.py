"""A link's two stages: the rate with its queue, then delay, jitter, loss, duplication, corruption and reordering."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from net.emulator.link import CORRUPT, DROP, DUPLICATE, PASS, EmulatedLink
from net.emulator.plan import Settings

MS = 1_000_000
WIDE_999 = 3.29
"""Standard deviations on each side that hold 99.9 % of a normal distribution."""


def link(**settings: object) -> EmulatedLink:
    return EmulatedLink("air:uav1:up", replace(Settings(), **settings), seed=11)  # type: ignore[arg-type]


def within(count: int, frames: int, share: float) -> bool:
    """Whether a count is in the 99.9 % interval of the binomial distribution."""
    return abs(count - frames * share) <= WIDE_999 * math.sqrt(frames * share * (1 - share)) + 1


def test_a_link_without_settings_lets_everything_go_at_once() -> None:
    free = link()
    assert [free.arrive(now, 1500) for now in (0, 5, 9)] == [(0, PASS), (5, PASS), (9, PASS)]


def test_a_frame_leaves_when_its_last_bit_is_sent_and_the_delay_is_over() -> None:
    slow = link(rate_bps=1_000_000, delay_us=10_000)
    assert slow.arrive(0, 125) == (11 * MS, PASS)
    assert slow.arrive(0, 250) == (13 * MS, PASS)
    assert slow.arrive(100 * MS, 125) == (111 * MS, PASS)


def test_what_waits_for_its_delay_does_not_fill_the_queue() -> None:
    long = link(rate_bps=1_000_000, queue_packets=2, delay_us=1_000_000)
    assert all(long.arrive(number * MS, 125)[1] == PASS for number in range(500))
    assert long.counters.queue == 0


def test_the_queue_holds_as_many_frames_as_it_says_and_drops_the_rest() -> None:
    slow = link(rate_bps=1_000_000, queue_packets=3)
    assert [slow.arrive(0, 125)[1] for _ in range(5)] == [PASS, PASS, PASS, DROP, DROP]
    assert slow.arrive(1 * MS, 125) == (4 * MS, PASS)
    assert slow.arrive(1 * MS, 125)[1] == DROP
    assert (slow.counters.entered, slow.counters.queue) == (7, 3)


def test_a_closed_link_drops_everything_and_says_so() -> None:
    shut = link(closed=True, delay_us=1000)
    assert {shut.arrive(now, 100)[1] for now in range(10)} == {DROP}
    assert shut.counters.closed == shut.counters.entered == 10


def test_a_change_is_for_frames_that_come_later() -> None:
    changing = link(delay_us=50_000)
    assert changing.arrive(0, 100) == (50 * MS, PASS)
    changing.change(Settings(delay_us=1000))
    assert changing.arrive(10 * MS, 100) == (50 * MS, PASS), "order is kept"
    assert changing.arrive(60 * MS, 100) == (61 * MS, PASS)


@pytest.mark.parametrize("share", [0.001, 0.05, 0.5])
@pytest.mark.parametrize(
    ("field", "counter"),
    [("loss", "random"), ("duplicate", "duplicated"), ("corrupt", "corrupted"), ("reorder", "reordered")],
)
def test_shares_are_those_asked_for(field: str, counter: str, share: float) -> None:
    frames = 40_000
    drawn = link(**{field: share, "delay_us": 5000})
    for number in range(frames):
        drawn.arrive(number * MS, 100)
    assert within(getattr(drawn.counters, counter), frames, share)


def test_losses_come_alone_as_often_as_chance_has_it() -> None:
    lossy = link(loss=0.2)
    lost = [lossy.arrive(number, 100)[1] == DROP for number in range(40_000)]
    both = sum(one and other for one, other in pairwise(lost))
    assert within(both, 40_000, 0.04)


def test_a_frame_that_is_lost_and_doubled_goes_on_once() -> None:
    both = link(loss=1.0, duplicate=1.0)
    assert both.arrive(0, 100) == (0, PASS)
    assert link(duplicate=1.0).arrive(0, 100) == (0, PASS | DUPLICATE)


def test_a_copy_is_delayed_lost_and_corrupted_by_itself_and_never_doubled() -> None:
    doubling = link(duplicate=1.0, corrupt=1.0, delay_us=1000)
    assert doubling.arrive(0, 100) == (1 * MS, PASS | CORRUPT | DUPLICATE)
    assert doubling.copy() == (1 * MS, PASS | CORRUPT)
    doubling.change(Settings(loss=1.0))
    assert doubling.copy()[1] == DROP


def test_a_frame_chosen_by_reorder_skips_its_delay_and_overtakes() -> None:
    overtaking = link(reorder=0.5, delay_us=10_000)
    found = {overtaking.arrive(number * 100 * MS, 100)[0] - number * 100 * MS for number in range(50)}
    assert found == {0, 10 * MS}


SETTINGS = st.builds(
    lambda rate, queue, delay, share, distribution, loss, reordering: Settings(
        rate, queue if rate else None, None, delay, int(delay * share), distribution, reordering, loss
    ),
    st.none() | st.integers(1000, 10**9),
    st.none() | st.integers(1, 50),
    st.integers(0, 100_000),
    st.floats(0, 1),
    st.sampled_from(["normal", "uniform", "pareto"]),
    st.sampled_from([0.0, 0.1, 1.0]),
    st.booleans(),
)
FRAMES = st.lists(st.tuples(st.integers(0, 50 * MS), st.integers(34, 1514)), min_size=1, max_size=100)


@given(settings=SETTINGS, frames=FRAMES)
def test_whatever_comes_leaves_later_in_order_or_is_counted(settings: Settings, frames: list[tuple[int, int]]) -> None:
    shaped, now, last = EmulatedLink("wan:gs:up", settings, seed=2), 0, 0
    fates = {PASS: 0, DROP: 0}
    for wait, size in frames:
        now += wait
        due, fate = shaped.arrive(now, size)
        fates[fate] += 1
        assert due >= now
        if fate == PASS and not settings.reordering:
            assert due >= last
            last = due
    counters = shaped.counters
    assert fates[DROP] == counters.queue + counters.random
    assert fates[PASS] + fates[DROP] == counters.entered == len(frames)


@given(shares=st.tuples(*[st.sampled_from([0.0, 0.3, 1.0])] * 3), frames=FRAMES)
def test_every_frame_and_every_copy_is_accounted_for(
    shares: tuple[float, float, float], frames: list[tuple[int, int]]
) -> None:
    loss, duplicate, corrupt = shares
    shaped = link(rate_bps=100_000, queue_packets=5, loss=loss, duplicate=duplicate, corrupt=corrupt)
    now, left = 0, 0
    for wait, size in frames:
        now += wait
        _, fate = shaped.arrive(now, size)
        left += fate != DROP
        if fate & DUPLICATE:
            left += shaped.copy()[1] != DROP
    found = shaped.counters
    assert found.entered + found.duplicated == left + found.queue + found.random


@given(settings=SETTINGS, frames=FRAMES)
def test_a_rate_is_never_exceeded(settings: Settings, frames: list[tuple[int, int]]) -> None:
    shaped = EmulatedLink("wan:gs:up", replace(settings, rate_bps=1_000_000, delay_us=0, jitter_us=0, loss=0.0), seed=2)
    now, busy_until = 0, 0
    for wait, size in frames:
        now += wait
        due, fate = shaped.arrive(now, size)
        if fate == PASS:
            assert due == max(busy_until, now) + size * 8000
            busy_until = due
