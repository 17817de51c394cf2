"""Routing hop by hop: a frame for a node that is not a neighbour is sent to the next node on the way.

Otherwise `net` would connect all nodes directly, and a frame from a UAV to the ground station would cross one cable
instead of three links. Each port gets its own routing table (ip-rule(8)), since the next hop depends on the port at
which a frame arrives.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence

from .interfaces import NetError, Port

FIRST_TABLE = 1000
"""Above 253 to 255, which the kernel uses, however many nodes there are."""
PRIORITY = 100
NodePair = tuple[str, str]


def parse_links(text: str, nodes: Sequence[str]) -> tuple[NodePair, ...]:
    """Parse `LINKS` of compose.yaml, `gs-cloud cloud-fog1 …`: pairs of nodes that form one tree. Raises NetError."""
    found: list[NodePair] = []
    for item in text.split():
        pair = tuple(item.split("-"))
        if len(pair) != 2 or pair[0] == pair[1] or not set(pair) <= set(nodes):
            raise NetError(f"LINKS {item!r}: expected NODE-NODE of {', '.join(nodes)}")
        found.append((pair[0], pair[1]))
    reached, joined = {nodes[0]}, len(found) == len(nodes) - 1
    for _ in found:
        reached |= {end for link in found for end in link if reached & set(link)}
    if not joined or reached != set(nodes):
        raise NetError(f"LINKS {text.split()}: expected one way between any two of {', '.join(nodes)}")
    return tuple(found)


def next_hops(links: Sequence[NodePair]) -> dict[tuple[str, str], str]:
    """For each (node, destination) the node's neighbour that is next on the way."""
    neighbours: dict[str, list[str]] = {}
    for one, other in links:
        neighbours.setdefault(one, []).append(other)
        neighbours.setdefault(other, []).append(one)
    found = {}
    for node in neighbours:
        for first in neighbours[node]:
            seen, ahead = {node}, [first]
            while ahead:
                here = ahead.pop()
                seen.add(here)
                found[node, here] = first
                ahead += [further for further in neighbours[here] if further not in seen]
    return found


def routing_commands(ports: Sequence[Port], links: Sequence[NodePair]) -> str:
    """The input of `ip -batch`: for each port a rule, and a route to every node that is not a neighbour."""
    by_node = {port.node: port for port in ports}
    hops = next_hops(links)
    lines = []
    for table, port in enumerate(ports, FIRST_TABLE):
        lines.append(f"rule add iif {port.interface} lookup {table} priority {PRIORITY}")
        for node, there in by_node.items():
            first = by_node[hops[port.node, node]] if node != port.node else there
            if first.node != node:
                lines.append(f"route add {there.cable.node} via {first.cable.node} dev {first.interface} table {table}")
    return "\n".join(lines) + "\n"


def route_by_hops(ports: Sequence[Port], links: Sequence[NodePair]) -> None:
    """Set the routes. Raises NetError with the error of `ip`."""
    done = subprocess.run(
        ["ip", "-batch", "-"], input=routing_commands(ports, links), capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise NetError(f"ip -batch: {' '.join(done.stderr.split())}")
