"""Every directed link has a queue of its own, and nothing passes besides."""

from __future__ import annotations

import pytest

from net.emulator.rules import check, rules, ways_of
from net.interfaces import Cable, NetError, Port

PORTS = [
    Port(node, Cable(f"198.18.{number}.2", f"198.18.{number}.3"), f"eth{number}", "")
    for number, node in enumerate(("gs", "cloud", "fog1"))
]
PAIRS = (("gs", "cloud"), ("cloud", "fog1"))
NAMES = ["wan:gs:up", "wan:gs:down", "backhaul:fog1:up", "backhaul:fog1:down"]


def test_up_is_towards_the_cloud() -> None:
    ways = ways_of(NAMES, PORTS, PAIRS)
    assert [(way.source.node, way.destination.node) for way in ways] == [
        ("gs", "cloud"),
        ("cloud", "gs"),
        ("fog1", "cloud"),
        ("cloud", "fog1"),
    ]


def test_packets_of_no_link_are_dropped_and_queues_are_never_bypassed() -> None:
    assert rules(ways_of(NAMES, PORTS, PAIRS)).splitlines() == [
        "*filter",
        ":FORWARD DROP",
        ":NET-SHAPE -",
        "-A FORWARD -j NET-SHAPE",
        "-A NET-SHAPE -i eth0 -o eth1 -j NFQUEUE --queue-num 0",
        "-A NET-SHAPE -i eth1 -o eth0 -j NFQUEUE --queue-num 1",
        "-A NET-SHAPE -i eth2 -o eth1 -j NFQUEUE --queue-num 2",
        "-A NET-SHAPE -i eth1 -o eth2 -j NFQUEUE --queue-num 3",
        "COMMIT",
    ]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["wan:gs"], "links 'wan:gs': expected CLASS:NODE:up or CLASS:NODE:down, NODE of gs, fog1"),
        (["wan:gs:left"], "links 'wan:gs:left': expected CLASS:NODE:up or CLASS:NODE:down, NODE of gs, fog1"),
        (["wan:cloud:up"], "links 'wan:cloud:up': expected CLASS:NODE:up or CLASS:NODE:down, NODE of gs, fog1"),
        (["air:uav9:up"], "links 'air:uav9:up': expected CLASS:NODE:up or CLASS:NODE:down, NODE of gs, fog1"),
        ([*NAMES, "x:gs:up"], "links 'x:gs:up': expected one link from gs to cloud"),
        (NAMES[:3], "links: none from cloud to fog1; expected one each way for every pair of LINKS"),
    ],
)
def test_links_that_are_not_those_of_the_network_are_named(names: list[str], said: str) -> None:
    with pytest.raises(NetError) as error:
        ways_of(names, PORTS, PAIRS)
    assert str(error.value) == said


def test_a_sense_link_leads_from_the_sensor_to_the_drone_that_it_is_named_after() -> None:
    ports = [Port(node, Cable("", ""), node, "") for node in ("cloud", "fog1", "uav1", "sensor1")]
    names = [
        "backhaul:fog1:up",
        "backhaul:fog1:down",
        "air:uav1:up",
        "air:uav1:down",
        "sense:uav1:up",
        "sense:uav1:down",
    ]
    ways = ways_of(names, ports, (("cloud", "fog1"), ("fog1", "uav1"), ("uav1", "sensor1")))
    assert [(way.source.node, way.destination.node) for way in ways[2:]] == [
        ("uav1", "fog1"),
        ("fog1", "uav1"),
        ("sensor1", "uav1"),
        ("uav1", "sensor1"),
    ]


def test_rules_in_force_are_those_that_were_asked_for() -> None:
    ways = ways_of(NAMES[:2], PORTS[:2], PAIRS[:1])
    shown = [
        *("-P INPUT ACCEPT", "-P FORWARD DROP", "-P OUTPUT ACCEPT", "-N NET-SHAPE"),
        *(line for line in rules(ways).splitlines() if line.startswith("-A")),
    ]
    check(ways, "\n".join(shown))
    with pytest.raises(NetError, match=r"rule 3: 'nothing'; expected '-A NET-SHAPE -i eth1 -o eth0 "):
        check(ways, "\n".join(shown[:-1]))
    with pytest.raises(NetError, match=r"rule 2: '-A FORWARD -j ACCEPT'; expected"):
        check(ways, "\n".join([*shown[:5], "-A FORWARD -j ACCEPT", *shown[5:]]))
    with pytest.raises(NetError, match="expected 3, and FORWARD to drop"):
        check(ways, "\n".join(["-P FORWARD ACCEPT", *shown[2:]]))
