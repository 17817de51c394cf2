"""Ports are found by address, whatever their names and order."""

from __future__ import annotations

import json

import pytest

from net.interfaces import Cable, NetError, Port, find_ports, parse_nodes


def addresses(**by_name: str) -> str:
    """What `ip -json addr` says."""
    links = [
        {
            "ifname": name,
            "address": f"02::{name}",
            "addr_info": [{"family": "inet6", "local": "fe80::1"}, {"family": "inet", "local": address}],
        }
        for name, address in by_name.items()
    ]
    return json.dumps([{"ifname": "down0"}, *links])


GS, CLOUD = Cable("198.18.0.2", "198.18.0.3"), Cable("198.18.1.2", "198.18.1.3")


def test_nodes_are_names_and_two_addresses() -> None:
    found = parse_nodes("gs=198.18.0.2,198.18.0.3\n cloud=198.18.1.2,198.18.1.3")
    assert found == {"gs": GS, "cloud": CLOUD}


EXPECTED = "expected NAME=NET'S ADDRESS,NODE'S ADDRESS, each name once"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "NODES: expected at least one NAME=NET'S ADDRESS,NODE'S ADDRESS"),
        ("gs", f"NODES 'gs': {EXPECTED}"),
        ("=198.18.0.2,198.18.0.3", f"NODES '=198.18.0.2,198.18.0.3': {EXPECTED}"),
        ("gs=198.18.0.2", f"NODES 'gs=198.18.0.2': {EXPECTED}"),
        ("gs=198.18.0.2,198.18", f"NODES 'gs=198.18.0.2,198.18': {EXPECTED}"),
        ("gs=1.1.1.1,1.1.1.2 gs=2.2.2.1,2.2.2.2", f"NODES 'gs=2.2.2.1,2.2.2.2': {EXPECTED}"),
    ],
)
def test_malformed_nodes_are_named(text: str, said: str) -> None:
    with pytest.raises(NetError) as error:
        parse_nodes(text)
    assert str(error.value) == said


def test_a_port_is_found_by_its_address() -> None:
    listed = addresses(eth7="198.18.0.2", eth0="198.18.1.2", lo="127.0.0.1")
    assert find_ports({"gs": GS, "cloud": CLOUD}, listed) == [
        Port("gs", GS, "eth7", "02::eth7"),
        Port("cloud", CLOUD, "eth0", "02::eth0"),
    ]


def test_every_missing_port_is_named() -> None:
    nodes = {"gs": GS, "cloud": CLOUD, "fog1": Cable("198.18.11.2", "198.18.11.3")}
    with pytest.raises(NetError) as error:
        find_ports(nodes, addresses(eth0="198.18.1.2"))
    assert str(error.value) == "NODES gs=198.18.0.2, fog1=198.18.11.2: expected an interface with that address"
