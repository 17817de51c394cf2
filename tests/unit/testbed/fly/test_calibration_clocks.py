"""Machines whose clocks differ: how far is found, and a link's delay is measured as by one clock."""

from __future__ import annotations

from typing import Any

import pytest

from net.link_plan import LinkPlan
from testbed.fly.calibration import calibrate
from testbed.fly.calibration.clocks import HERE, ahead_ns, measure_clocks
from testbed.plan.fleets import standard_fleet
from testbed.plan.machines import machines_of
from tests.handmade.clocked_nodes import ClockedNodes
from tests.handmade.simulated_links import TWO, plan_of

FLEET = standard_fleet()
MACHINES = machines_of({"MACHINES": "ssh://a,ssh://b"}, FLEET)
NODES = ("gs", "fog1", "fog2")
ADDRESSES = {
    address: name for node in NODES for address, name in ((FLEET.address(node), node), (FLEET.gateway(node), "net"))
}


def _nodes(ahead: dict[str, int], takes: int | None = 60_000) -> ClockedNodes:
    ways: dict[tuple[str, str], Any] = {("net", node): 40_000 for node in NODES}
    return ClockedNodes(ADDRESSES, ahead, ways | {(node, "net"): takes for node in NODES})


def test_nothing_is_measured_where_all_is_on_one_machine() -> None:
    assert measure_clocks(FLEET, (), _nodes({}).run) == ()


def test_the_way_to_each_machine_and_its_clock_are_found() -> None:
    ahead = {"fog1": 7_000_000, "fog2": -3_000_000}
    here, first, second = measure_clocks(FLEET, MACHINES, _nodes(ahead).run)
    assert (here.machine, first.machine, second.machine) == (HERE, "a", "b")
    assert [way.round_trip_ms for way in (here, first, second)] == [0.1, 0.1, 0.1]
    assert [way.ahead_ms for way in (here, first, second)] == pytest.approx([-0.01, 6.99, -3.01]), (
        "to half a way's time"
    )
    assert first.off is None
    assert ahead_ns([first])["uav3"] == 6_990_000


def test_clocks_that_are_far_apart_and_a_machine_that_is_silent_are_named() -> None:
    _, first, _ = measure_clocks(FLEET, MACHINES, _nodes({"fog1": 80_000_000}).run)
    assert first.off == "a: its clock is +80.0 ms from this one's: expected 50 ms or less (NTP)"
    _, first, _ = measure_clocks(FLEET, MACHINES, _nodes({}, takes=None).run)
    assert first.off == "a: no datagram came from fog1 to net or back"


def test_a_links_delay_is_measured_as_by_one_clock() -> None:
    ahead = {"gs": 4_000_000, "cloud": -9_000_000}
    addresses = {node.address: node.name for node in TWO.nodes}
    nodes = ClockedNodes(addresses, ahead, {("gs", "cloud"): 20_000_000, ("cloud", "gs"): 30_000_000})
    plan = plan_of(LinkPlan(delay_us=20_000), LinkPlan(delay_us=30_000))
    found = calibrate(plan, TWO, nodes.run, None, ahead)
    delays = [check.measured for check in found.checks if check.figure == "delay_ms"]
    assert delays == pytest.approx([20.0, 30.0])
    assert found.off == ()
