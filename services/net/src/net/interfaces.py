"""Finds interfaces by address: in a container with many, neither their names nor their order are stable."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

STATUS_FILE = Path("/proc/self/status")
NET_ADMIN = 12
"""The capability's number (linux/capability.h)."""
OFFLOADS = ("tso", "gso", "gro", "tx", "rx")
"""If any of them is on, a capture shows frames that were never on a wire."""


class NetError(Exception):
    """The network is not as required; the text names the fault and what was expected."""


@dataclass(frozen=True)
class Cable:
    """The two addresses of a node's network: `net`'s, and the node's own."""

    net: str
    node: str


@dataclass(frozen=True)
class Port:
    """The interface of `net` towards a node; its own `mac` shows the direction of a captured frame."""

    node: str
    cable: Cable
    interface: str
    mac: str


def parse_nodes(text: str) -> dict[str, Cable]:
    """Parse `NODES` of compose.yaml, `gs=198.18.0.2,198.18.0.3 cloud=…`: each node's name, net's address towards it and
    its own. Raises NetError."""
    found: dict[str, Cable] = {}
    for item in text.split():
        node, _, addresses = item.partition("=")
        parts = addresses.split(",")
        if not node or node in found or len(parts) != 2 or any(part.count(".") != 3 for part in parts):
            raise NetError(f"NODES {item!r}: expected NAME=NET'S ADDRESS,NODE'S ADDRESS, each name once")
        found[node] = Cable(*parts)
    if not found:
        raise NetError("NODES: expected at least one NAME=NET'S ADDRESS,NODE'S ADDRESS")
    return found


def find_ports(nodes: dict[str, Cable], ip_addr_json: str) -> list[Port]:
    """The port of every node, from the output of `ip -json addr`. Raises NetError if one is missing."""
    by_address = {
        info["local"]: (link["ifname"], link.get("address", ""))
        for link in json.loads(ip_addr_json)
        for info in link.get("addr_info", ())
        if info.get("family") == "inet"
    }
    missing = [f"{node}={cable.net}" for node, cable in nodes.items() if cable.net not in by_address]
    if missing:
        raise NetError(f"NODES {', '.join(missing)}: expected an interface with that address")
    return [Port(node, cable, *by_address[cable.net]) for node, cable in nodes.items()]


def read_ports(nodes: dict[str, Cable]) -> list[Port]:
    """The ports of this container."""
    listed = subprocess.run(["ip", "-json", "addr"], check=True, capture_output=True, text=True)
    return find_ports(nodes, listed.stdout)


def check_rights() -> None:
    """Raise NetError without CAP_NET_ADMIN, which every command here needs."""
    lines = STATUS_FILE.read_text().splitlines()
    effective = next(line.split()[1] for line in lines if line.startswith("CapEff:"))
    if not int(effective, 16) >> NET_ADMIN & 1:
        raise NetError(f"capabilities {effective}: no CAP_NET_ADMIN; expected cap_add: [NET_ADMIN] as in compose.yaml")


def turn_off_offloads(port: Port) -> None:
    """Turn off a port's offloads. Raises NetError if one stays on."""
    flags = [word for offload in OFFLOADS for word in (offload, "off")]
    subprocess.run(["ethtool", "-K", port.interface, *flags], check=False, capture_output=True)
    shown = subprocess.run(["ethtool", "-k", port.interface], check=True, capture_output=True, text=True).stdout
    wanted = ("tcp-segmentation-offload", "generic-segmentation-offload", "generic-receive-offload", "tx-checksumming")
    for line in shown.splitlines():
        name, _, state = line.partition(":")
        if name in wanted and not state.strip().startswith("off"):
            raise NetError(f"{port.interface} towards {port.node}: {name} stays on; expected off")
