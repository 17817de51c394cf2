"""Clocks and stamps (section 4); that no deadline is late and no age too small, `test_clock_bounds` says."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mqttxt.core.clock import (
    LATEST_MS,
    Beacon,
    RemoteClock,
    SessionClock,
    expiry_s,
    stamp,
    stamp_is_newer,
    stamp_supersedes,
    system_clock_ns,
)

MS = st.integers(0, 3_600_000)


@given(st.lists(st.tuples(MS, st.integers(0, 20_000)), min_size=1, max_size=8), st.integers(1, 60_000))
def test_delayed_beacons_only_make_deadlines_earlier(beacons: list[tuple[int, int]], ttl_ms: int) -> None:
    now = max(sent + delay for sent, delay in beacons)
    one_by_one, prompt = RemoteClock(7), RemoteClock(7)
    for sent, delay in beacons:
        one_by_one.observe(Beacon(7, sent), sent + delay)
        prompt.observe(Beacon(7, sent), sent)
    late, best = one_by_one.deadline_ms(now, ttl_ms), prompt.deadline_ms(now, ttl_ms)
    assert late is not None
    assert best is not None
    assert late <= best <= now + ttl_ms


def test_without_a_beacon_there_is_no_deadline_and_without_an_echo_no_age() -> None:
    clock = RemoteClock(7)
    assert clock.deadline_ms(0, 5000) is None
    clock.observe(Beacon(7, 100), 50)
    assert clock.deadline_ms(50, 1000) is not None
    assert clock.age_ms(0, 60) is None
    assert clock.is_live(50 + 30_000)
    assert not clock.is_live(50 + 30_001)


def test_a_clock_that_claims_the_latest_time_still_gives_a_deadline_that_can_be_carried() -> None:
    clock = RemoteClock(7)
    clock.observe(Beacon(7, LATEST_MS), 50)
    assert clock.deadline_ms(50, 60_000) == LATEST_MS


def test_a_beacon_of_another_session_is_no_beacon() -> None:
    with pytest.raises(ValueError, match="session 8"):
        RemoteClock(7).observe(Beacon(8, 0), 0)


@given(st.integers(0, 10**9), st.integers(1, 300_000))
def test_stamps_order_what_is_less_than_five_minutes_apart(first_ms: int, gap_ms: int) -> None:
    assume(stamp(first_ms) != stamp(first_ms + gap_ms))
    assert stamp_is_newer(stamp(first_ms + gap_ms), stamp(first_ms))
    assert not stamp_is_newer(stamp(first_ms), stamp(first_ms + gap_ms))


def test_after_minutes_without_a_word_arrival_decides() -> None:
    """Half a span later every stamp looks older: a drone that was out of reach must be heard at once."""
    assert not stamp_is_newer(stamp(400_000), stamp(0))
    assert stamp_supersedes(stamp(400_000), stamp(0), 400_000)
    assert not stamp_supersedes(stamp(0), stamp(1000), 10)


def test_a_session_is_random_and_its_clock_starts_at_zero() -> None:
    now = [5_000_000_000]
    clock = SessionClock(lambda: now[0])
    assert clock.now_ms() == 0
    now[0] += 1_999_999
    assert clock.now_ms() == 1
    assert len({SessionClock().session for _ in range(50)}) == 50
    assert all(0 < SessionClock().session < 2**32 for _ in range(50))
    assert system_clock_ns() <= system_clock_ns()


@pytest.mark.parametrize(("left_ms", "seconds"), [(-5, 1), (0, 1), (1, 1), (1000, 1), (1001, 2), (59_999, 60)])
def test_message_expiry_is_never_zero(left_ms: int, seconds: int) -> None:
    assert expiry_s(left_ms) == seconds
