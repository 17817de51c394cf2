"""Clocks: deadlines are never late and ages never too small, whatever delays a beacon (section 4)."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mqttxt.core.clock import (
    LATEST_MS,
    RHO,
    Beacon,
    RemoteClock,
    SessionClock,
    expiry_s,
    stamp,
    stamp_is_newer,
    stamp_supersedes,
    system_clock_ns,
)

RATES = st.floats(1 - RHO, 1 + RHO)
MS = st.integers(0, 3_600_000)


@given(RATES, RATES, MS, st.integers(0, 30_000), st.integers(0, 600_000), st.integers(1, 60_000), st.integers(0, 10**6))
def test_a_deadline_is_never_later_than_what_the_sender_meant(
    sender_rate: float, executor_rate: float, sent_ms: int, transit_ms: int, waited_ms: int, ttl_ms: int, offset: int
) -> None:
    """In true time the executor's clock reads D no later than the sender's ttl has passed by any clock in rho."""
    received = sent_ms + transit_ms
    asked = received + waited_ms
    clock = RemoteClock(7)
    beacon = Beacon(7, int(offset + sent_ms * executor_rate))
    clock.observe(beacon, received_ms=int(received * sender_rate))
    deadline = clock.deadline_ms(int(asked * sender_rate), ttl_ms)
    assert deadline is not None
    true_end = asked + ttl_ms
    assert deadline <= offset + true_end * executor_rate

    early = offset + true_end * executor_rate - deadline
    assert early <= transit_ms * (1 + RHO) + 4 * RHO * (waited_ms + ttl_ms) + 8 + 2 * RHO * transit_ms


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


@given(RATES, RATES, MS, st.integers(0, 5000), st.integers(0, 2000), st.integers(0, 5000), st.integers(0, 300_000))
def test_an_age_is_an_upper_bound(
    own_rate: float, remote_rate: float, asked: int, there: int, held: int, back: int, later: int
) -> None:
    """`asked` by true time; the remote process holds the nonce, answers, and stamps something afterwards."""
    answered = asked + there + held
    clock = RemoteClock(7)
    held_ms = int(answered * remote_rate) - int((asked + there) * remote_rate)
    clock.observe(
        Beacon(7, int(answered * remote_rate), 1, max(0, held_ms)),
        received_ms=int((answered + back) * own_rate),
        asked_ms=int(asked * own_rate),
    )
    stamped_at = answered + back
    now = stamped_at + later
    age = clock.age_ms(stamp(int(stamped_at * remote_rate)), int(now * own_rate))
    assert age is not None
    assume(later < 500_000)
    assert age >= later * remote_rate


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
