"""The bounds of docs/deadlines.md, checked against the code in exact rationals: no rounding hides anything."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import floor

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from mqttxt.core import clock as clocks
from mqttxt.core.clock import MAX_TTL_MS, STAMP_TICK_MS, Beacon, RemoteClock, stamp
from tests.examples import examples

RHO = Fraction(1, 1000)
SLOWEST = 1 - 2 * RHO
PPM = Fraction(1, 1_000_000)

rates = st.one_of(st.sampled_from([1 - RHO, 1 + RHO, Fraction(1)]), st.integers(-1000, 1000).map(lambda e: 1 + e * PPM))
instants = st.one_of(
    st.integers(0, 2_000_000).map(lambda ns: ns * PPM), st.integers(0, 20_000_000).map(lambda us: us * PPM * 1000)
)
"""Milliseconds: below 2 ms in nanoseconds, below 20 s in microseconds."""
ages = st.one_of(instants, st.integers(0, 600_000).map(Fraction))
looked_after = st.one_of(instants, st.integers(0, 299_000).map(Fraction))
"""As long as the order of stamps can be told."""
starts = st.one_of(st.integers(0, 10**6), st.integers(0, 2**52)).flatmap(
    lambda whole: st.integers(0, 999_999).map(lambda ns: whole + ns * PPM)
)
ttls = st.integers(1, MAX_TTL_MS)


@dataclass(frozen=True)
class Clock:
    """A clock by true time: what it reads at 0, and the rate that it keeps from each instant to the next."""

    start: Fraction
    rates: tuple[Fraction, ...]

    def exact(self, *until: Fraction) -> list[Fraction]:
        """What it shows at 0 and at the end of each duration."""
        shown = [self.start]
        for duration, rate in zip(until, self.rates, strict=True):
            shown.append(shown[-1] + duration * rate)
        return shown


def drifting(durations: int) -> st.SearchStrategy[Clock]:
    return st.builds(Clock, starts, st.tuples(*[rates] * durations))


@examples(300)
@given(drifting(3), drifting(3), instants, ages, ttls)
@example(Clock(Fraction(0), (1 - RHO,) * 3), Clock(Fraction(0), (1 + RHO,) * 3), Fraction(0), Fraction(0), 1)
@example(Clock(PPM, (1 + RHO,) * 3), Clock(Fraction(0), (1 - RHO,) * 3), Fraction(0), Fraction(600_000), MAX_TTL_MS)
def test_one_hop_is_never_late_and_early_by_no_more_than_the_bound(
    executor: Clock, sender: Clock, transit: Fraction, age: Fraction, ttl: int
) -> None:
    """Theorem 1 and 3: true time runs from the beacon over its receipt and the call to the true deadline."""
    sent, _, _, at_end = executor.exact(transit, age, Fraction(ttl))
    _, received, called, _ = sender.exact(transit, age, Fraction(ttl))
    known = RemoteClock(7)
    known.observe(Beacon(7, floor(sent)), floor(received))
    deadline = known.deadline_ms(floor(called), ttl)
    assert deadline is not None
    assert at_end >= deadline + 1, "at the true deadline the executor's clock reads past D"
    early = (1 + RHO) * transit + (4 * RHO - 2 * RHO**2) * age + 3 * RHO * ttl + 5 - 4 * RHO
    assert at_end - deadline < early


@examples(300)
@given(drifting(2), drifting(2), instants, ages, st.integers(1, 2 * MAX_TTL_MS))
def test_a_relay_hands_on_no_more_time_than_it_has_left(
    executor: Clock, relay: Clock, transit: Fraction, age: Fraction, left: int
) -> None:
    """Theorem 2: `end` is the instant at which the relay's clock first reads past its own D."""
    _, received, now = relay.exact(transit, age)
    deadline = floor(now) + left
    durations = (transit, age + (deadline + 1 - now) / relay.rates[1])
    _, _, shown = relay.exact(*durations)
    assert shown == deadline + 1
    sent, _, at_end = executor.exact(*durations)

    known = RemoteClock(7)
    known.observe(Beacon(7, floor(sent)), floor(received))
    handed_on = known.deadline_ms(floor(now), deadline - floor(now))
    assert handed_on is not None
    assert at_end >= handed_on + 1
    own = deadline + 1 - received
    assert at_end - handed_on < (1 + RHO) * transit + (4 * RHO - 2 * RHO**2) / (1 - RHO) * own + 5 - 4 * RHO


@examples(200)
@given(
    st.tuples(drifting(4), drifting(4), drifting(4)),
    instants,
    instants,
    instants,
    st.integers(1, MAX_TTL_MS),
    st.data(),
)
def test_over_two_hops_nothing_is_late(
    clocks_: tuple[Clock, Clock, Clock], transit: Fraction, age: Fraction, way: Fraction, ttl: int, data: st.DataObject
) -> None:
    """Both beacons leave at 0; the command is called, reaches the relay after `way`, and the drone at the end."""
    drone, relay, station = clocks_
    way = min(way, Fraction(ttl))
    durations = (transit, age, way, ttl - way)
    drone_at, relay_at, station_at = (clock.exact(*durations) for clock in (drone, relay, station))
    heard_relay, heard_drone = RemoteClock(1), RemoteClock(2)
    heard_relay.observe(Beacon(1, floor(relay_at[0])), floor(station_at[1]))
    heard_drone.observe(Beacon(2, floor(drone_at[0])), floor(relay_at[1]))

    first = heard_relay.deadline_ms(floor(station_at[2]), ttl)
    assert first is not None
    left = first - floor(relay_at[3])
    if left <= 0:
        return  # the activator says `expired`
    second = heard_drone.deadline_ms(floor(relay_at[3]), left)
    assert second is not None
    assert floor(drone_at[4]) > second, "at the true deadline the drone refuses"
    early = 2 * ((1 + RHO) * transit + 4 * RHO * (age + ttl) + 5) * (1 + 3 * RHO)
    assert drone_at[4] - second < early


@examples(150)
@given(drifting(6), drifting(6), st.tuples(*[instants] * 6), st.lists(st.integers(0, 5), max_size=8), ttls)
def test_of_several_beacons_in_any_order_the_largest_deadline_is_safe(
    executor: Clock, sender: Clock, durations: tuple[Fraction, ...], order: list[int], ttl: int
) -> None:
    """Beacon k leaves at instant k and comes at any later one, or several times: duplicates and reordering."""
    executor_at, sender_at = executor.exact(*durations), sender.exact(*durations)
    known = RemoteClock(7)
    alone = []
    for sent, received in sorted(((min(k, at), at) for k, at in enumerate(order)), key=lambda one: one[1]):
        single = RemoteClock(7)
        for one in (known, single):
            one.observe(Beacon(7, floor(executor_at[sent])), floor(sender_at[received]))
        alone.append(single)
    assume(alone)
    now = floor(sender_at[6])
    best = known.deadline_ms(now, ttl)
    assert best == max(found for one in alone if (found := one.deadline_ms(now, ttl)) is not None)
    assert executor_at[6] + (1 - RHO) * ttl >= best + 1


@examples(300)
@given(drifting(5), drifting(5), instants, instants, instants, ages, looked_after)
def test_the_upper_bound_is_one_and_ages_never_too_small(
    remote: Clock, own: Clock, there: Fraction, held: Fraction, back: Fraction, later: Fraction, aged: Fraction
) -> None:
    """Theorem 4: asked at 0; held by the remote; `later` it stamps something that is looked at `aged` after."""
    durations = (there, held, back, later, aged)
    remote_at, own_at = remote.exact(*durations), own.exact(*durations)
    known = RemoteClock(7)
    held_ms = floor(remote_at[2]) - floor(remote_at[1])
    known.observe(Beacon(7, floor(remote_at[2]), 1, held_ms), floor(own_at[3]), floor(own_at[0]))
    for index in (3, 4, 5):
        latest = known.latest_now_ms(floor(own_at[index]))
        assert latest is not None
        assert latest >= remote_at[index]
    assume(remote_at[5] - remote_at[4] < 300_000)
    age = known.age_ms(stamp(floor(remote_at[4])), floor(own_at[5]))
    assert age is not None
    over = age - (remote_at[5] - remote_at[4])
    since = there + held + back + later + aged
    unknown = (1 + RHO) * (there + back) + 4 * RHO * since * (1 + RHO) + held * 4 * RHO
    if remote_at[5] - remote_at[4] + unknown < 600_000:
        assert 0 <= over < unknown + STAMP_TICK_MS + 7


@examples(150)
@given(drifting(6), drifting(6), st.tuples(*[instants] * 6), st.lists(st.tuples(*[st.integers(0, 6)] * 3), max_size=6))
def test_clocks_within_rho_never_contradict_themselves(
    remote: Clock, own: Clock, durations: tuple[Fraction, ...], echoes: list[tuple[int, int, int]]
) -> None:
    """Whatever is asked, echoed and received in whatever order, nothing that was known is forgotten."""
    remote_at, own_at = remote.exact(*durations), own.exact(*durations)
    known = RemoteClock(7)
    best = None
    for asked, answered, received in sorted((tuple(sorted(echo)) for echo in echoes), key=lambda echo: echo[2]):
        beacon = Beacon(7, floor(remote_at[answered]), 1, floor(remote_at[answered]) - floor(remote_at[asked]))
        known.observe(beacon, floor(own_at[received]), floor(own_at[asked]))
        found = known.deadline_ms(floor(own_at[6]), 1000)
        assert found is not None
        assert best is None or found >= best
        best = found
        latest = known.latest_now_ms(floor(own_at[6]))
        assert latest is not None
        assert latest >= remote_at[6]


def test_a_clock_that_stood_still_is_noticed_with_the_next_echo() -> None:
    """A paused virtual machine lags by 4 s: until an echo D is too late by that much, then it is right again."""
    known = RemoteClock(7)
    known.observe(Beacon(7, 10_000, 1, 0), 10_000, 10_000)
    known.observe(Beacon(7, 16_000, 2), 20_000)
    before = known.deadline_ms(20_000, 1000)
    known.observe(Beacon(7, 16_010, 3, 0), 20_020, 20_000)
    after = known.deadline_ms(20_020, 1000)
    assert before is not None
    assert after is not None
    assert before > 20_900
    assert 16_900 < after <= 17_010


def test_a_clock_that_jumped_ahead_is_noticed_with_the_next_beacon() -> None:
    known = RemoteClock(7)
    known.observe(Beacon(7, 10_000, 1, 0), 10_000, 10_000)
    known.observe(Beacon(7, 24_000), 20_000)
    assert known.latest_now_ms(20_000) is None
    deadline = known.deadline_ms(20_000, 1000)
    assert deadline is not None
    assert 24_900 < deadline <= 25_000


def _worst_lateness_ms() -> Fraction:
    """How far past the true deadline an executor still starts, for clocks and instants chosen to show it."""
    worst = Fraction(-(10**9))
    edges = (Fraction(0), PPM, 1 - PPM)
    for rate_e, rate_s in [(1 - RHO, 1 + RHO), (1 - RHO, 1 - RHO), (1 + RHO, 1 + RHO)]:
        for start_e, start_s in [(a, b) for a in edges for b in edges]:
            for age, ttl in [(0, 1), (1, 1), (2 + PPM, 1), (10_000, 5000)]:
                executor, sender = Clock(start_e, (rate_e,) * 3), Clock(start_s, (rate_s,) * 3)
                durations = (Fraction(0), Fraction(age), Fraction(ttl))
                executor_at, sender_at = executor.exact(*durations), sender.exact(*durations)
                known = RemoteClock(7)
                known.observe(Beacon(7, floor(executor_at[0])), floor(sender_at[1]))
                deadline = known.deadline_ms(floor(sender_at[2]), ttl)
                assert deadline is not None
                worst = max(worst, (deadline + 1 - executor_at[3]) / rate_e)
    return worst


@pytest.mark.parametrize(("name", "value"), [("_SLOWEST", 1000), ("_SLOWEST", 999), ("_SLOWEST", 997)])
def test_the_margin_is_what_makes_it_safe(name: str, value: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without 2 rho, or with half of it, there are clocks within rho that make a command late; with more, none."""
    assert _worst_lateness_ms() <= 0
    monkeypatch.setattr(clocks, name, value)
    assert (_worst_lateness_ms() > 0) is (value > 998)


@pytest.mark.parametrize("missing", ["r counts as one more", "D is one less"])
def test_both_whole_milliseconds_are_needed(missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    observe, deadline_ms = RemoteClock.observe, RemoteClock.deadline_ms
    if missing == "D is one less":
        monkeypatch.setattr(RemoteClock, "deadline_ms", lambda self, now, ttl: deadline_ms(self, now, ttl) + 1)
    else:
        monkeypatch.setattr(RemoteClock, "observe", lambda self, beacon, r, asked=None: observe(self, beacon, r - 1))
    assert _worst_lateness_ms() > 0


def test_the_rate_inequality_of_the_derivation() -> None:
    """1 - 2 rho lies below (1 - rho) / (1 + rho), by less than 2 rho squared; 1 + 2 rho not above its inverse."""
    for lower, higher in pairwise([1 - 2 * RHO, (1 - RHO) / (1 + RHO), Fraction(1)]):
        assert lower < higher
    assert (1 - RHO) / (1 + RHO) - SLOWEST < 2 * RHO**2
    assert 1 + 2 * RHO < (1 + RHO) / (1 - RHO)
    assert Fraction(clocks._SLOWEST, clocks._SLOWEST_OF) == SLOWEST
    assert Fraction(clocks._FASTEST, clocks._FASTEST_OF) == (1 + RHO) / (1 - RHO)
    assert Fraction(str(clocks.RHO)) == RHO
