"""Estimators on data whose answer is known, and how wide their tolerances have to be."""

from __future__ import annotations

import pytest

from net.emulator.jitter import make_jitter
from net.link_plan import LinkPlan
from testbed.fly.calibration.estimate import (
    ArrivedProbe,
    delay_figures,
    first_copies,
    rate_when_overfilled,
    rate_when_received,
)
from testbed.fly.calibration.expected import ExpectedDelays, arriving, rate_bps
from tests.examples import first_quick

MS = 1_000_000


def rows(delays_ms: list[float], every_ms: float = 25.0) -> list[ArrivedProbe]:
    return [
        ArrivedProbe(number, int(number * every_ms * MS), int((number * every_ms + delay_ms) * MS))
        for number, delay_ms in enumerate(delays_ms)
    ]


def test_delays_are_told_without_the_time_of_sending() -> None:
    found = delay_figures(rows([10.0] * 40), sending_ms=2.0)
    assert found is not None
    assert (found.median_ms, found.mean_ms, found.middle_ms) == pytest.approx((8.0, 8.0, 8.0))
    assert (found.deviation_ms, found.span_ms) == pytest.approx((0.0, 0.0))


def test_a_few_late_probes_change_neither_middle_nor_span() -> None:
    found = delay_figures(rows([10.0] * 37 + [80.0] * 3), sending_ms=0.0)
    assert found is not None
    assert (found.middle_ms, found.span_ms) == pytest.approx((10.0, 0.0))
    assert found.mean_ms == pytest.approx(15.25)


def test_too_few_probes_say_nothing() -> None:
    assert delay_figures(rows([10.0] * 4), 0.0) is None
    assert delay_figures([], 0.0) is None
    assert rate_when_received([], 100) is None
    assert rate_when_overfilled(rows([10.0] * 4), 2, 100, 1.0) is None


def test_of_copies_the_first_counts() -> None:
    assert first_copies([ArrivedProbe(1, 0, 9), ArrivedProbe(0, 0, 5), ArrivedProbe(1, 0, 7)]) == [
        ArrivedProbe(0, 0, 5),
        ArrivedProbe(1, 0, 7),
    ]


def test_a_full_links_rate_is_told_by_when_those_that_got_in_were_sent_whatever_their_delays() -> None:
    every_ns = 640_000  # 100 bytes at 1.25 Mbit/s: four of five get into a link of 1 Mbit/s
    got_in = [number for number in range(500) if number < 30 or number % 5]
    burst = [ArrivedProbe(number, 0, 40 * MS) for number in got_in if number < 30]
    paced = [
        ArrivedProbe(number, (number - 29) * every_ns, number * every_ns + number % 7 * 30 * MS)
        for number in got_in
        if number >= 30
    ]
    assert rate_when_overfilled(burst + paced, 30, 100, 1.0) == pytest.approx(1_000_000, rel=0.01)
    assert rate_when_overfilled(burst + paced, 30, 100, 0.8) == pytest.approx(1_250_000, rel=0.01)


def test_a_sender_that_pauses_and_catches_up_does_not_change_the_rate() -> None:
    burst = [ArrivedProbe(number, 0, 0) for number in range(30)]
    steady = [ArrivedProbe(30 + number, (number + 1) * 800_000, 0) for number in range(300)]
    paused = [
        row if not 100 <= row.number < 110 else ArrivedProbe(row.number, 110 * 800_000 - 29 * 800_000, 0)
        for row in steady
    ]
    for sent in (steady, paused):
        assert rate_when_overfilled(burst + sent, 30, 100, 1.0) == pytest.approx(1_000_000, rel=0.01)


def test_arrivals_one_behind_the_other_tell_the_rate_though_some_are_lost() -> None:
    came = [ArrivedProbe(number, 0, (100 + number * 10) * MS) for number in range(60) if number % 9]
    assert rate_when_received(came, 80) == pytest.approx(64_000)
    assert rate_when_received([ArrivedProbe(number, 0, 5) for number in range(9)], 80) is None


@pytest.mark.long
@pytest.mark.parametrize("distribution", first_quick(["normal", "uniform", "pareto"]))
def test_right_links_are_hardly_ever_out_of_tolerance(distribution: str) -> None:
    """99.9 % are within by the reckoning: of 300 more than 5 are out once in a million times."""
    link = LinkPlan(delay_us=60_000, jitter_us=10_000, distribution=distribution)
    delays, every_ms, count = ExpectedDelays(link), 30.0, 84
    out = 0
    for seed in range(300):
        jitter = make_jitter(distribution, 10 * MS, False, seed, "air:uav1:up")
        told = rows([60.0 + jitter(int(number * every_ms * MS)) / MS for number in range(count)], every_ms)
        found = delay_figures(told, 0.0)
        assert found is not None
        lasts_s = count * every_ms / 1e3
        out += not delays.middle_ms(count, lasts_s).holds(found.middle_ms)
        out += not delays.jitter_ms(count, lasts_s).holds(delays.jitter_of(found.span_ms))
    assert out <= 5


def test_tolerances_are_narrow_where_nothing_is_drawn() -> None:
    steady = ExpectedDelays(LinkPlan(delay_us=45_000)).middle_ms(40, 1.0)
    assert (steady.lowest, steady.expected, steady.highest) == pytest.approx((44.25, 45.0, 47.45))


def test_a_delay_is_never_negative_in_what_is_expected_either() -> None:
    link = ExpectedDelays(LinkPlan(delay_us=1_000, jitter_us=1_000))
    assert link.middle_ms(40, 1.0).expected > 1.0
    assert link.span_ms < 2.57


def test_frames_that_skip_their_delay_are_expected_to() -> None:
    link = ExpectedDelays(LinkPlan(delay_us=40_000, reorder=0.25))
    assert link.middle_ms(40, 1.0).expected == pytest.approx(40 * (0.9 - 0.25) / 0.8, rel=0.01)


def test_what_loss_and_turned_bits_take_widens_the_rates_tolerance() -> None:
    lossy = LinkPlan(1_000_000, 50, loss=0.1, corrupt=0.1)
    assert arriving(lossy) == pytest.approx(0.81)
    steady, thinned = rate_bps(LinkPlan(1_000_000, 50), 150, 0.5), rate_bps(lossy, 150, 0.5)
    assert steady.highest == pytest.approx(1_000_000 * (1 + 0.02 + 2 / 150 + 0.002 / 0.5))
    assert thinned.highest > steady.highest * 1.1
