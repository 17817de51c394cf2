"""Calibration with real packets: probes without any right on the nodes, links by the emulator in between."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from net.link_plan import LinkPlan
from testbed.fly.calibration import Calibration, calibrate, check_losses
from testbed.fly.calibration.calibrate import run_schedule
from testbed.fly.calibration.schedule import make_load
from testbed.plan.profiles.resolve import LinksPlan
from testbed.plan.topology import Link, Node, Topology
from tests.rigs.shaped_link import DOWN, SUBNETS, UP, ShapedLink
from tests.rigs.shaped_nodes import PYTHON

pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(120),
    pytest.mark.soak(
        *("services/net/src", "testbed/fly/calibration", "testbed/plan/profiles/resolve.py"),
        *("tests/rigs/shaped_link.py", "tests/rigs/shaped_nodes.py", "tests/rigs/link_probe.py"),
    ),
]
TOPOLOGY = Topology(
    tuple(Node(name, f"{subnet}.3") for name, subnet in SUBNETS.items()), (Link("wan:gs", "gs", "cloud"),)
)
FAST = LinkPlan(20_000_000, 100, delay_us=30_000, jitter_us=5_000, loss=0.02)
SLOW = LinkPlan(128_000, 10, delay_us=10_000)


def plan_of(up: LinkPlan, down: LinkPlan) -> LinksPlan:
    return LinksPlan("own", 5, {UP: up, DOWN: down}, ())


def calibrated(link: ShapedLink, plan: LinksPlan) -> Calibration:
    return calibrate(plan, TOPOLOGY, lambda node, command: link.output(node, command, user="1000:1000"))


def test_links_are_as_planned_and_their_loss_is_counted(link: ShapedLink) -> None:
    plan = plan_of(FAST, SLOW)
    with link.shaping(asdict(FAST), down=asdict(SLOW)) as emulator:
        found = calibrated(link, plan)
        load = make_load(plan, TOPOLOGY, {})
        run_schedule(load, lambda node, command: link.output(node, command, user="1000:1000"))
        counters = emulator.end()
    assert found.off == ()
    measured = {(check.link, check.figure): check.measured for check in found.checks}
    assert measured[UP, "rate_bps"] == pytest.approx(20_000_000, rel=0.1)
    assert measured[DOWN, "rate_bps"] == pytest.approx(128_000, rel=0.05)
    assert counters["links"][UP]["random"] > 10
    assert check_losses(plan, counters) == ()
    assert [line.split()[:2] for line in check_losses(plan_of(LinkPlan(), SLOW), counters)] == [[UP, "loss:"]]


def test_a_delay_that_is_not_the_plans_and_a_link_that_does_not_let_through_are_named(link: ShapedLink) -> None:
    planned = LinkPlan(delay_us=20_000)
    with link.shaping(asdict(LinkPlan(delay_us=60_000)), down=asdict(LinkPlan(loss=1.0))):
        found = calibrated(link, plan_of(planned, planned))
    assert found.rounds == 3
    assert found.off[0].startswith(f"{UP} delay: configured 20 ms, measured 6")
    assert any(line.startswith(f"{DOWN} delay: configured 20 ms, measured nothing (0 of 40 ") for line in found.off)


def test_a_probe_that_begins_too_late_says_so(link: ShapedLink) -> None:
    schedule = json.dumps({"run": 1, "begin_ns": 1, "end_s": 1, "flows": []})
    said = link.output("gs", [PYTHON, "-m", "net.probe", schedule], user="1000:1000")
    assert json.loads(said)["late_ms"] > 0
    code, words = link.net([PYTHON, "-m", "net", "probe", "{}"], user="1000:1000")
    assert (code, words) == (2, "net probe: schedule.run: None: expected int\n")
