"""What is not for a neighbour goes to the next node on the way, by a table for each port."""

from __future__ import annotations

import pytest

from net.hops import next_hops, parse_links, routing_commands
from net.interfaces import Cable, NetError, Port

NODES = ("gs", "cloud", "fog1", "uav1", "uav2")
LINKS = (("gs", "cloud"), ("cloud", "fog1"), ("fog1", "uav1"), ("fog1", "uav2"))


def test_links_are_pairs_of_nodes() -> None:
    assert parse_links("gs-cloud cloud-fog1\n fog1-uav1 fog1-uav2", NODES) == LINKS


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gs", "LINKS 'gs': expected NODE-NODE of gs, cloud, fog1"),
        ("gs-gs", "LINKS 'gs-gs': expected NODE-NODE of gs, cloud, fog1"),
        ("gs-moon", "LINKS 'gs-moon': expected NODE-NODE of gs, cloud, fog1"),
        ("gs-cloud", "LINKS ['gs-cloud']: expected one way between any two of gs, cloud, fog1"),
        ("gs-cloud gs-cloud", "LINKS ['gs-cloud', 'gs-cloud']: expected one way between any two of gs, cloud, fog1"),
    ],
)
def test_links_that_make_no_tree_are_named(text: str, said: str) -> None:
    with pytest.raises(NetError) as error:
        parse_links(text, NODES[:3])
    assert str(error.value) == said


def test_the_next_hop_is_the_neighbour_on_the_way() -> None:
    hops = next_hops(LINKS)
    assert [hops["uav1", to] for to in ("gs", "cloud", "fog1", "uav2")] == ["fog1"] * 4
    assert [hops["fog1", to] for to in ("gs", "uav1", "uav2")] == ["cloud", "uav1", "uav2"]
    assert hops["gs", "uav2"] == hops["gs", "cloud"] == "cloud"


def test_only_what_is_not_for_a_neighbour_needs_a_route() -> None:
    ports = [Port(node, Cable(f"10.0.{i}.2", f"10.0.{i}.3"), f"eth{i}", "") for i, node in enumerate(NODES)]
    lines = routing_commands(ports, LINKS).splitlines()
    assert lines[:4] == [
        "rule add iif eth0 lookup 1000 priority 100",
        "route add 10.0.2.3 via 10.0.1.3 dev eth1 table 1000",
        "route add 10.0.3.3 via 10.0.1.3 dev eth1 table 1000",
        "route add 10.0.4.3 via 10.0.1.3 dev eth1 table 1000",
    ]
    assert "route add 10.0.0.3 via 10.0.2.3 dev eth2 table 1003" in lines
    assert not any("10.0.2.3 via 10.0.2.3" in line for line in lines)
