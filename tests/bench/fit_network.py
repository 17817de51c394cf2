"""The testbed's ten nodes with `net` between them, in containers of their own, to shape replayed streams."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Self

from testbed.plan.profiles.resolve import LinksPlan
from testbed.plan.topology import Topology
from tests.rigs.shaped_nodes import FOLDER, PYTHON, READY_TIMEOUT_S, ShapedNodes

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

    @contextmanager
    def shaping(self, plan: LinksPlan) -> Iterator[None]:
        """Run the emulator while this is entered; afterwards `counters` has its counts."""
        self.write_plan(plan.to_data())
        self.output("net", ["rm", "-f", f"{FOLDER}/ready"])
        script = ["sh", "-c", f'echo $$ > {FOLDER}/pid; exec "$@"', "sh", *self.shape_command()]
        with ThreadPoolExecutor(1) as thread:
            running = thread.submit(self.nodes["net"].exec_run, script, environment=self.environment)
            try:
                self._wait_for_ready(running.done)
                yield
            finally:
                self.nodes["net"].exec_run(["sh", "-c", f"kill -TERM $(cat {FOLDER}/pid)"])
            code, said = running.result(READY_TIMEOUT_S)
            assert code == 0, said.decode()

    def counters(self) -> dict[str, Any]:
        """The last file that the emulator wrote."""
        content: dict[str, Any] = json.loads(self.output("net", ["cat", f"{FOLDER}/counters.json"]))
        return content

    def _wait_for_ready(self, has_ended: Any) -> None:
        deadline = time.monotonic() + READY_TIMEOUT_S
        while self.nodes["net"].exec_run(["test", "-e", f"{FOLDER}/ready"]).exit_code:
            assert time.monotonic() < deadline, "the emulator does not become ready"
            assert not has_ended(), "the emulator has ended"
            time.sleep(0.05)
