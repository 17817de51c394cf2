"""What the nodes are asked to send: every link both ways, at moderate rates, in a few seconds."""

from __future__ import annotations

import json
from itertools import pairwise

import pytest

from net.link_plan import LinkPlan
from net.probe import parse_schedule
from testbed.fly.calibration.schedule import DELAY, RATE, CalibrationFlow, CalibrationSchedule, make_schedule
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.reading import profile_names, read_profile
from testbed.plan.profiles.resolve import LinksPlan, resolve
from tests.handmade.simulated_links import DOWN, TWO, UP, plan_of

TOPOLOGY = standard_fleet().topology()


def of_profile(name: str) -> tuple[LinksPlan, CalibrationSchedule]:
    plan = resolve(read_profile(name), TOPOLOGY, "scenario-1", 1)
    return plan, make_schedule(plan, TOPOLOGY, {}, frozenset(plan.links))


def of_links(up: LinkPlan, down: LinkPlan | None = None) -> dict[tuple[str, str], CalibrationFlow]:
    plan = plan_of(up, down)
    schedule = make_schedule(plan, TWO, {}, frozenset(plan.links))
    return {(flow.link, flow.purpose): flow for flow in schedule.flows}


@pytest.mark.parametrize("name", profile_names())
def test_every_link_is_probed_both_ways_and_every_rate_that_there_is(name: str) -> None:
    plan, schedule = of_profile(name)
    assert {flow.link for flow in schedule.flows if flow.purpose == DELAY} == set(plan.links)
    rated = {link for link, figures in plan.links.items() if figures.rate_bps is not None}
    assert {flow.link for flow in schedule.flows if flow.purpose == RATE} == rated
    assert schedule.length_s <= {"edge": 12.0, "3g": 11.0, "sik": 8.0, "thesis": 7.0}.get(name, 6.0)


@pytest.mark.parametrize("name", profile_names())
def test_the_shaper_meets_a_moderate_number_of_frames(name: str) -> None:
    _, schedule = of_profile(name)
    times = sorted(
        flow.at_s + max(0, number - flow.burst + 1) * flow.every_s
        for flow in schedule.flows
        for number in range(flow.burst, flow.count)
    )
    busiest = max(sum(1 for time in times if start <= time < start + 0.1) for start in times[::50])
    assert busiest <= 2_000, "in a tenth of a second"


@pytest.mark.parametrize("name", profile_names())
def test_a_node_takes_its_schedule_as_it_is(name: str) -> None:
    _, schedule = of_profile(name)
    for node in schedule.nodes:
        given = schedule.of_node(node, 7, 1_000)
        parsed = parse_schedule(json.dumps(given))
        assert [flow.flow for flow in parsed.flows] == [f.number for f in schedule.flows if f.source == node]
        assert all(f.sent_s * 1e9 == pytest.approx(p.due_ns(p.count - 1), abs=1e3) for f, p in zip(
            (f for f in schedule.flows if f.source == node), parsed.flows, strict=True
        ))  # fmt: skip


def test_delay_probes_are_far_enough_apart_that_none_waits_for_the_one_before() -> None:
    flows = of_links(LinkPlan(delay_us=100_000, jitter_us=30_000), LinkPlan(1_000, 4))
    assert flows[UP, DELAY].every_s >= 3 * 0.030
    assert flows[DOWN, DELAY].every_s >= 2 * flows[DOWN, DELAY].frame_bytes * 8 / 1_000


def test_more_probes_are_sent_where_some_get_lost() -> None:
    assert of_links(LinkPlan(loss=0.5))[UP, DELAY].count == 2 * of_links(LinkPlan())[UP, DELAY].count


def test_a_rate_probe_overfills_the_queue_and_then_offers_a_quarter_more_than_the_rate() -> None:
    flow = of_links(LinkPlan(1_200_000, 100))[UP, RATE]
    assert flow.burst > 100
    assert flow.frame_bytes * 8 / flow.every_s == pytest.approx(1.25 * 1_200_000)
    assert flow.count - flow.burst >= 1.25 * 40


def test_the_two_ways_of_a_shared_medium_are_never_saturated_at_once() -> None:
    flows = of_links(LinkPlan(64_000, 30, DOWN), LinkPlan(64_000, 30, UP))
    up, down = flows[UP, RATE], flows[DOWN, RATE]
    assert down.at_s >= up.sent_s + 30 * up.frame_bytes * 8 / 64_000
    spacing = flows[UP, DELAY].every_s
    assert flows[DOWN, DELAY].at_s - flows[UP, DELAY].at_s == pytest.approx(spacing / 2)


def test_fast_links_are_probed_one_after_the_other_and_slow_ones_together() -> None:
    _, fast = of_profile("lte")
    rates = [flow for flow in fast.flows if flow.purpose == RATE]
    assert len(rates) == 12
    assert all(one.sent_s < other.at_s for one, other in pairwise(rates))
    _, slow = of_profile("3g")
    assert len({flow.at_s for flow in slow.flows if flow.purpose == RATE}) == 1


def test_a_deep_queue_is_not_filled() -> None:
    flow = of_links(LinkPlan(64_000, 5_000))[UP, RATE]
    assert not flow.overfills
    assert flow.count == flow.burst <= 5_000


def test_a_fast_rate_that_is_probed_again_is_probed_for_longer() -> None:
    plan = plan_of(LinkPlan(50_000_000, 100))
    first, third = (
        next(flow for flow in make_schedule(plan, TWO, {}, frozenset([UP]), again).flows if flow.purpose == RATE)
        for again in (0, 2)
    )
    assert first.sent_s - first.at_s >= 0.06
    assert third.sent_s - third.at_s >= 0.24
