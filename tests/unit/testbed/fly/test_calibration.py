"""Calibration over simulated links whose figures are known: right links pass, wrong ones are named in one line."""

from __future__ import annotations

import json
import random

import pytest

from net.link_plan import LinkPlan
from net.probe import HEAD
from testbed.errors import FleetError, ProbesLate
from testbed.fly.calibration import Calibration, calibrate
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.reading import profile_names, read_profile
from testbed.plan.profiles.resolve import LinksPlan, resolve
from tests.handmade.simulated_links import DOWN, TWO, UP, SimulatedNodes, changed, plan_of

TOPOLOGY = standard_fleet().topology()
RADIO = LinkPlan(64_000, 30, DOWN, 40_000, 20_000, loss=0.01)
SHARED = plan_of(RADIO, LinkPlan(64_000, 30, UP, 40_000, 20_000, loss=0.01))


def measured(plan: LinksPlan, really: LinksPlan | None = None, **options: object) -> Calibration:
    """What is measured for a plan over links that are `really` so."""
    nodes = SimulatedNodes(really or plan, **options)  # type: ignore[arg-type]
    return calibrate(plan, TWO, nodes.run)


def test_no_probe_is_taken_for_mavlink(monkeypatch: pytest.MonkeyPatch) -> None:
    class Highest:
        def getrandbits(self, bits: int) -> int:
            return int(2**bits - 1)

    nodes, runs = SimulatedNodes(SHARED), []

    def run(node: str, command: list[str]) -> str:
        runs.append(json.loads(command[-1])["run"])
        return nodes.run(node, command)

    monkeypatch.setattr(random, "SystemRandom", Highest)
    calibrate(SHARED, TWO, run)
    assert runs != []
    assert max(HEAD.pack(number, 0, 0, 0, 0)[0] for number in runs) < 0xFD


@pytest.mark.parametrize("profile", profile_names())
def test_links_that_are_as_planned_are_within_tolerance(profile: str) -> None:
    plan = resolve(read_profile(profile), TOPOLOGY, "scenario-1", 1)
    found = calibrate(plan, TOPOLOGY, SimulatedNodes(LinksPlan(plan.profile, plan.seed, plan.links, ()), TOPOLOGY).run)
    assert found.off == ()
    assert {check.link for check in found.checks} == set(plan.links)


@pytest.mark.parametrize(
    ("link", "figure", "wrong", "said"),
    [
        (LinkPlan(delay_us=45_000), "delay_us", 60_000, "delay: configured 45 ms, measured 60 ms (40 of 40 probes"),
        (LinkPlan(), "delay_us", 3_000, "delay: configured 0 ms, measured 3 ms"),
        (LinkPlan(delay_us=45_000), "jitter_us", 5_000, "jitter: configured 0 ms, measured "),
        (LinkPlan(delay_us=45_000, jitter_us=15_000), "jitter_us", 0, "jitter: configured 15 ms, measured 0 ms"),
        (LinkPlan(1_000_000, 50), "rate_bps", 1_100_000, "rate: configured 1Mbit, measured 1.1Mbit"),
        (LinkPlan(50_000_000, 100), "rate_bps", 45_000_000, "rate: configured 50Mbit, measured 45Mbit"),
    ],
)
def test_a_wrong_figure_is_named_beside_what_was_configured(link: LinkPlan, figure: str, wrong: int, said: str) -> None:
    plan = plan_of(link)
    nodes = SimulatedNodes(changed(plan, UP, **{figure: wrong}))
    found = calibrate(plan, TWO, nodes.run)
    named = [line for line in found.off if line.startswith(f"{UP} {said}")]
    assert len(named) == 1, found.off
    assert "; expected " in named[0]
    assert all(line.startswith(UP) for line in found.off)
    assert nodes.rounds == found.rounds == 3


def test_a_link_that_loses_and_duplicates_has_its_rate() -> None:
    """A frame that is both lost and duplicated passes once."""
    plan = plan_of(LinkPlan(64_000, 10, delay_us=5_000, loss=0.9, duplicate=1.0))
    assert calibrate(plan, TWO, SimulatedNodes(plan).run).off == ()


def test_a_shared_slow_rate_is_measured_one_way_after_the_other() -> None:
    found = measured(SHARED)
    rates = [check.measured for check in found.checks if check.figure == "rate_bps"]
    assert rates == pytest.approx([64_000, 64_000], rel=0.05)


def test_half_of_a_shared_rate_is_off_in_both_directions() -> None:
    half = changed(changed(SHARED, UP, rate_bps=32_000), DOWN, rate_bps=32_000)
    found = measured(SHARED, half)
    assert [line.split()[:2] for line in found.off] == [[UP, "rate:"], [DOWN, "rate:"]]


def test_a_rate_behind_a_queue_that_cannot_be_filled_is_read_off_the_arrivals() -> None:
    plan = plan_of(LinkPlan(64_000, 5_000, None, 40_000, 20_000), LinkPlan(1_000, 4))
    found = measured(plan)
    rates = {check.link: check.measured for check in found.checks if check.figure == "rate_bps"}
    assert found.off == ()
    assert rates[UP] == pytest.approx(64_000, rel=0.2)
    assert rates[DOWN] == pytest.approx(1_000, rel=0.1)


def test_where_nothing_arrives_each_figure_says_so() -> None:
    found = measured(plan_of(LinkPlan(1_000_000, 50, delay_us=20_000)), lost=lambda number: True)
    assert [line for line in found.off if line.startswith(f"{UP} ")] == [
        f"{UP} delay: configured 20 ms, measured nothing (0 of 40 probes arrived); expected 19.5 ms to 22.2 ms",
        f"{UP} jitter: configured 0 ms, measured nothing (0 of 40 probes arrived); expected 0 ms to 2 ms",
        next(line for line in found.off if line.startswith(f"{UP} rate: configured 1Mbit, measured nothing (0 of ")),
    ]


def test_a_lost_probe_changes_nothing() -> None:
    assert measured(plan_of(LinkPlan(1_000_000, 50, delay_us=20_000)), lost=lambda number: number == 7).off == ()


def test_a_figure_that_is_off_once_is_probed_again() -> None:
    plan = plan_of(LinkPlan(delay_us=20_000))
    right, wrong = SimulatedNodes(plan), SimulatedNodes(changed(plan, UP, delay_us=40_000))
    asked: list[list[str]] = []

    def run(node: str, command: list[str]) -> str:
        asked.append([flow["to"] for flow in json.loads(command[-1])["flows"]])
        return (wrong if len(asked) <= 2 else right).run(node, command)

    found = calibrate(plan, TWO, run)
    assert found.off == ()
    assert found.rounds == 2
    assert [line.partition(";")[0] for line in found.again] == [
        f"{UP} delay: configured 20 ms, measured 40 ms (40 of 40 probes arrived)"
    ]
    assert sorted(asked[2:]) == [[], ["198.18.1.3"]], "only the way that was off"


def test_probes_that_begin_too_late_are_given_more_time_before_the_run_is_given_up() -> None:
    plan = plan_of(LinkPlan(delay_us=20_000))
    assert calibrate(plan, TWO, SimulatedNodes(plan, late=2).run).off == ()
    with pytest.raises(ProbesLate, match="the probe began 25 ms late, 8 s after it was asked for"):
        calibrate(plan, TWO, SimulatedNodes(plan, late=3).run)


def test_what_a_probe_says_instead_of_its_results_is_passed_on() -> None:
    with pytest.raises(FleetError, match="the probe of its links said: net probe: UDP port 19799: Address already"):
        calibrate(plan_of(LinkPlan()), TWO, lambda node, command: "net probe: UDP port 19799: Address already in use\n")
    with pytest.raises(FleetError, match="said: nothing"):
        calibrate(plan_of(LinkPlan()), TWO, lambda node, command: "")


def test_what_is_not_probed_says_why() -> None:
    plan = plan_of(LinkPlan(50_000_000, 2, loss=0.1), LinkPlan(1_000_000_000, 500, loss=0.95))
    data = measured(plan).to_data()["links"]
    assert data[UP]["rate_bps"]["note"] == "its queue is empty after 0.2 ms, sooner than a sender can keep it full"
    assert data[DOWN]["delay_ms"]["note"] == "loses 95% of what is sent"
    assert measured(plan_of(LinkPlan())).to_data()["links"][UP]["rate_bps"]["note"] == "unlimited"


def test_a_closed_link_is_not_probed_in_either_direction() -> None:
    plan = plan_of(LinkPlan(1_000_000, 50, delay_us=20_000))
    found = calibrate(plan, TWO, lambda node, command: "", closed={"wan:gs": "its drone is not near"})
    assert found.off == ()
    assert {check.note for check in found.checks} == {"its drone is not near"}


def test_the_data_has_configured_beside_measured_for_each_directed_link() -> None:
    data = measured(plan_of(LinkPlan(1_000_000, 50, delay_us=20_000, jitter_us=2_000))).to_data()
    assert data["off"] == []
    assert data["links"][UP]["delay_ms"]["configured"] == 20.0
    assert data["links"][UP]["delay_ms"]["measured"] == pytest.approx(20.0, abs=2)
    assert {"lowest", "highest", "median", "mean", "arrived", "sent"} <= set(data["links"][UP]["delay_ms"])
    assert data["links"][UP]["jitter_ms"]["measured"] == pytest.approx(2.0, abs=1)
    assert data["links"][UP]["rate_bps"]["measured"] == pytest.approx(1_000_000, rel=0.02)
