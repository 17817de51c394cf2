"""Interfaces found by their address: in a container with many, neither their names nor their order are stable."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass

OFFLOADS = ("tso", "gso", "gro", "tx", "rx")
"""With any of them on, a capture shows frames that were never on a wire."""


class NetError(Exception):
    """Something about the network is not as it has to be; the text says what and what was expected."""


@dataclass(frozen=True)
class Port:
    """`net`'s interface towards a node."""

    node: str
    address: str
    interface: str


def parse_nodes(text: str) -> dict[str, str]:
    """`NODES` as in compose.yaml, `gs=198.18.0.2 cloud=…`: each node's name and net's address towards it."""
    found: dict[str, str] = {}
    for item in text.split():
        node, _, address = item.partition("=")
        if not node or address.count(".") != 3 or node in found:
            raise NetError(f"NODES {item!r}: expected NAME=ADDRESS, each name once")
        found[node] = address
    if not found:
        raise NetError("NODES: expected at least one NAME=ADDRESS")
    return found


def find_ports(nodes: dict[str, str], ip_addr_json: str) -> list[Port]:
    """The port of every node, from the output of `ip -json addr`; raises NetError when one is missing."""
    by_address = {
        info["local"]: link["ifname"]
        for link in json.loads(ip_addr_json)
        for info in link.get("addr_info", ())
        if info.get("family") == "inet"
    }
    missing = [f"{node}={address}" for node, address in nodes.items() if address not in by_address]
    if missing:
        raise NetError(f"NODES {', '.join(missing)}: expected an interface with that address")
    return [Port(node, address, by_address[address]) for node, address in nodes.items()]


def read_ports(nodes: dict[str, str]) -> list[Port]:
    """The ports of this container."""
    listed = subprocess.run(["ip", "-json", "addr"], check=True, capture_output=True, text=True)
    return find_ports(nodes, listed.stdout)


def turn_off_offloads(port: Port) -> None:
    """Raises NetError where an offload stays on."""
    flags = [word for offload in OFFLOADS for word in (offload, "off")]
    subprocess.run(["ethtool", "-K", port.interface, *flags], check=False, capture_output=True)
    shown = subprocess.run(["ethtool", "-k", port.interface], check=True, capture_output=True, text=True).stdout
    wanted = ("tcp-segmentation-offload", "generic-segmentation-offload", "generic-receive-offload", "tx-checksumming")
    for line in shown.splitlines():
        name, _, state = line.partition(":")
        if name in wanted and not state.strip().startswith("off"):
            raise NetError(f"{port.interface} towards {port.node}: {name} stays on; expected off")
