"""Random loss against the shaper's counters: exact intervals, for all links of a run together."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import pytest

from net.emulator.link import DROP, DUPLICATE
from net.emulator.network import Network
from net.emulator.plan import parse_plan
from net.link_plan import EventPlan, LinkPlan
from testbed.fly.calibration.losses import binomial_interval, check_losses, measure_losses
from testbed.plan.profiles.resolve import LinksPlan
from tests.handmade.simulated_links import DOWN, UP, plan_of


def counters(up: tuple[int, int], down: tuple[int, int] = (0, 0), **others: int) -> dict[str, Any]:
    """(lost at random, left) of each way."""
    return {
        "links": {UP: {"random": up[0], "left": up[1], **others}, DOWN: {"random": down[0], "left": down[1], **others}}
    }


def tail(trials: int, share: float, counts: range) -> float:
    """By whole numbers."""
    return sum(math.comb(trials, count) * share**count * (1 - share) ** (trials - count) for count in counts)


@pytest.mark.parametrize(("trials", "share"), [(20, 0.05), (400, 0.01), (60, 0.5), (300, 0.98)])
@pytest.mark.parametrize("outside", [0.001, 0.05])
def test_the_interval_is_the_narrowest_whose_tails_are_small_enough(trials: int, share: float, outside: float) -> None:
    low, high = binomial_interval(trials, share, outside)
    assert tail(trials, share, range(low)) <= outside / 2 < tail(trials, share, range(low + 1))
    assert (
        tail(trials, share, range(high + 1, trials + 1)) <= outside / 2 < tail(trials, share, range(high, trials + 1))
    )


def test_the_interval_of_many_frames_is_the_normal_distributions() -> None:
    low, high = binomial_interval(1_000_000, 0.05, 0.001)
    assert (low, high) == pytest.approx((50_000 - 3.29 * 218, 50_000 + 3.29 * 218), abs=15)


def test_nothing_is_drawn_without_frames_or_chance() -> None:
    assert binomial_interval(0, 0.5, 0.001) == (0, 0)
    assert binomial_interval(100, 0.0, 0.001) == (0, 0)
    assert binomial_interval(100, 1.0, 0.001) == (100, 100)


def test_a_loss_as_planned_is_not_mentioned_and_another_is_told_with_its_counts() -> None:
    plan = plan_of(LinkPlan(loss=0.05))
    assert check_losses(plan, counters((52, 948))) == ()
    assert check_losses(plan, counters((92, 908))) == (
        f"{UP} loss: configured 5 %, measured 9.2 % (92 of 1000 frames); expected 29 to 74",
    )
    assert check_losses(plan, counters((0, 1000)))[0].startswith(f"{UP} loss: configured 5 %, measured 0 % (0 of 1000")


@pytest.mark.parametrize(("loss", "duplicate"), [(0.05, 0.3), (0.5, 0.5), (0.3, 1.0), (1.0, 1.0)])
def test_a_link_that_loses_and_duplicates_is_as_planned(loss: float, duplicate: float) -> None:
    """netem counts no drop of a frame that is chosen for both: it passes once."""
    plan = plan_of(LinkPlan(loss=loss, duplicate=duplicate))
    shaped = Network(parse_plan(plan.to_data(), "plan")).links[UP]
    for number in range(20_000):
        _, fate = shaped.arrive(number, 100)
        shaped.counters.left += fate != DROP
        if fate & DUPLICATE:
            shaped.counters.left += shaped.copy()[1] != DROP
    assert check_losses(plan, {"links": {UP: asdict(shaped.counters)}}) == ()
    found = shaped.counters
    assert found.entered + found.duplicated == found.left + found.random


def test_a_link_that_loses_none_may_not_lose_one() -> None:
    said = check_losses(plan_of(LinkPlan()), counters((1, 4999)))
    assert said == (f"{UP} loss: configured 0 %, measured 0.02 % (1 of 5000 frames); expected 0 to 0",)


def test_what_the_queue_or_a_closed_link_took_was_never_drawn() -> None:
    assert check_losses(plan_of(LinkPlan(loss=0.05)), counters((50, 950), queue=4000, closed=900)) == ()


def test_the_interval_is_wider_the_more_links_there_are() -> None:
    one = measure_losses(plan_of(LinkPlan(loss=0.05)), counters((50, 950)))[0]
    two = measure_losses(plan_of(LinkPlan(loss=0.05), LinkPlan(loss=0.05)), counters((50, 950), (50, 950)))[0]
    assert (one.lowest, one.highest) == binomial_interval(1000, 0.05, 0.001)
    assert (two.lowest, two.highest) == binomial_interval(1000, 0.05, 0.0005)


def test_a_link_whose_loss_changes_is_skipped_and_says_why() -> None:
    base = plan_of(LinkPlan(loss=0.05), LinkPlan(loss=0.05))
    events = (EventPlan(5.0, UP, 1.0, {"loss": 0.5}), EventPlan(5.0, DOWN, 1.0, {"closed": True}))
    plan = LinksPlan("own", 1, base.links, events)
    up, down = measure_losses(plan, counters((400, 600), (400, 600)))
    assert (up.off, up.note) == (None, "its loss changes by events")
    assert down.off is not None, "what a closed link refuses is counted by itself"
    up, down = measure_losses(base, counters((400, 600), (400, 600)), changed=["wan:gs"])
    assert {up.note, down.note} == {"changed by hand"}
    up, down = measure_losses(base, counters((400, 600), (400, 600)), changed=[UP])
    assert (up.note, down.note) == ("changed by hand", None)


def test_a_link_that_nobody_counted_and_one_without_frames_are_not_off() -> None:
    plan = plan_of(LinkPlan(loss=0.05))
    up, down = measure_losses(plan, {"links": {UP: {"random": 0, "left": 0}}})
    assert (up.off, up.measured, down.off, down.note) == (None, None, None, "not counted")
    assert up.to_data()["configured"] == 0.05
