"""Ports are found by address, whatever their names and order."""

from __future__ import annotations

import json

import pytest

from net.interfaces import NetError, Port, find_ports, parse_nodes


def addresses(**by_name: str) -> str:
    """What `ip -json addr` says."""
    links = [
        {"ifname": name, "addr_info": [{"family": "inet6", "local": "fe80::1"}, {"family": "inet", "local": address}]}
        for name, address in by_name.items()
    ]
    return json.dumps([{"ifname": "down0"}, *links])


def test_nodes_are_names_and_addresses() -> None:
    assert parse_nodes("gs=198.18.0.2\n cloud=198.18.1.2") == {"gs": "198.18.0.2", "cloud": "198.18.1.2"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "NODES: expected at least one NAME=ADDRESS"),
        ("gs", "NODES 'gs': expected NAME=ADDRESS, each name once"),
        ("=198.18.0.2", "NODES '=198.18.0.2': expected NAME=ADDRESS, each name once"),
        ("gs=198.18", "NODES 'gs=198.18': expected NAME=ADDRESS, each name once"),
        ("gs=198.18.0.2 gs=198.18.1.2", "NODES 'gs=198.18.1.2': expected NAME=ADDRESS, each name once"),
    ],
)
def test_malformed_nodes_are_named(text: str, said: str) -> None:
    with pytest.raises(NetError) as error:
        parse_nodes(text)
    assert str(error.value) == said


def test_a_port_is_found_by_its_address() -> None:
    nodes = {"gs": "198.18.0.2", "cloud": "198.18.1.2"}
    listed = addresses(eth7="198.18.0.2", eth0="198.18.1.2", lo="127.0.0.1")
    assert find_ports(nodes, listed) == [Port("gs", "198.18.0.2", "eth7"), Port("cloud", "198.18.1.2", "eth0")]


def test_every_missing_port_is_named() -> None:
    nodes = {"gs": "198.18.0.2", "cloud": "198.18.1.2", "fog1": "198.18.11.2"}
    with pytest.raises(NetError) as error:
        find_ports(nodes, addresses(eth0="198.18.1.2"))
    assert str(error.value) == "NODES gs=198.18.0.2, fog1=198.18.11.2: expected an interface with that address"
