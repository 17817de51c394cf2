"""The testbed's ten nodes with `net` between them, in containers of their own, to shape replayed streams."""

from __future__ import annotations

from typing import Self

from testbed.plan.profiles.resolve import LinksPlan
from testbed.plan.topology import Topology
from tests.rigs.shaped_nodes import PYTHON, Running, ShapedNodes

FIRST_SUBNET = 100
_ROUTE = """
import os
from net.hops import parse_links, route_by_hops
from net.interfaces import parse_nodes, read_ports
nodes = parse_nodes(os.environ["NODES"])
route_by_hops(read_ports(nodes), parse_links(os.environ["LINKS"], list(nodes)))
"""


class ShapedNetwork(ShapedNodes):
    """The nodes of a topology; `shaping` runs the emulator in `net`."""

    def __init__(self, topology: Topology) -> None:
        subnets = {node.name: f"198.19.{FIRST_SUBNET + place}" for place, node in enumerate(topology.nodes)}
        super().__init__("fit", subnets, " ".join(f"{link.upper}-{link.lower}" for link in topology.links))

    def address(self, node: str) -> str:
        return f"{self._subnets[node]}.3"

    def up(self) -> Self:
        """Start the containers, and route between them hop by hop."""
        super().up()
        self.output("net", [PYTHON, "-c", _ROUTE], environment=self.environment)
        return self

    def shaping(self, plan: LinksPlan) -> Running:
        """Run the emulator while this is entered; afterwards `counters` has its counts."""
        self.write_plan(plan.to_data())
        return Running(self, self.shape_command())
