"""The testbed's ten nodes with `net` between them, in containers of their own, to shape replayed streams."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import docker
from docker.types import IPAMConfig, IPAMPool

from testbed.plan.profiles.resolve import LinksPlan
from testbed.plan.topology import Topology
from tests.bench.fit_streams import ROOT

IMAGE = os.environ.get("NODE_IMAGE", "mqttxt-testbed/node:latest")
PYTHON = "/opt/venv/bin/python"
REPOSITORY = "/repository"
FIRST_SUBNET = 100
FOLDER = "/tmp/shaping"
READY_TIMEOUT_S = 30.0
_ROUTE = """
import os
from net.hops import parse_links, route_by_hops
from net.interfaces import parse_nodes, read_ports
nodes = parse_nodes(os.environ["NODES"])
route_by_hops(read_ports(nodes), parse_links(os.environ["LINKS"], list(nodes)))
"""


class ShapedNetwork:
    """A container for each node; `shaping` runs the emulator of this source tree in `net`."""

    def __init__(self, topology: Topology) -> None:
        self._client = docker.from_env(timeout=120)
        self._topology = topology
        self._subnets = {node.name: f"198.19.{FIRST_SUBNET + place}" for place, node in enumerate(topology.nodes)}
        self._networks: dict[str, Any] = {}
        self.nodes: dict[str, Any] = {}

    def address(self, node: str) -> str:
        return f"{self._subnets[node]}.3"

    def up(self) -> ShapedNetwork:
        """Start the containers; what one is told comes from compose.yaml's `node` and `net`."""
        mark = f"mqttxt-fit-{os.getpid()}"
        for node, subnet in self._subnets.items():
            pool = IPAMPool(subnet=f"{subnet}.0/24")
            self._networks[node] = self._client.networks.create(f"{mark}-{node}", ipam=IPAMConfig(pool_configs=[pool]))
        first = next(iter(self._subnets))
        self.nodes["net"] = self._container(
            f"{mark}-net", first, 2, cap_add=["NET_ADMIN", "NET_RAW", "DAC_OVERRIDE"], cpu_shares=4096,
            sysctls={f"net.ipv4.{name}": str(value) for name, value in _NET_SYSCTLS.items()},
        )  # fmt: skip
        for node, subnet in self._subnets.items():
            if node != first:
                self._networks[node].connect(self.nodes["net"], ipv4_address=f"{subnet}.2")
            self.nodes[node] = self._container(
                f"{mark}-{node}", node, 3, cap_add=["NET_ADMIN", "SYS_NICE"], sysctls={"net.ipv4.ip_forward": "1"}
            )
        for container in self.nodes.values():
            container.start()
        for node, subnet in self._subnets.items():
            self.output(node, ["ethtool", "-K", "eth0", "tso", "off", "gso", "off", "gro", "off", "tx", "off"])
            self.output(node, ["ip", "route", "replace", "default", "via", f"{subnet}.2"])
        self.output("net", [PYTHON, "-c", _ROUTE], environment=self._environment())
        return self

    def down(self) -> None:
        """Remove what `up` made."""
        for container in self.nodes.values():
            container.remove(force=True)
        for network in self._networks.values():
            network.remove()
        self._client.close()

    def output(self, node: str, command: Sequence[str], **options: Any) -> str:
        """What a command that has to succeed prints."""
        code, said = self.nodes[node].exec_run(list(command), **options)
        assert code == 0, f"{node}: {' '.join(command)}: {said.decode()}"
        return str(said.decode())

    @contextmanager
    def shaping(self, plan: LinksPlan) -> Iterator[None]:
        """The emulator at work; `counters` after it has what it counted."""
        text = json.dumps(plan.to_data())
        self.output("net", ["sh", "-c", f'mkdir -p {FOLDER} && printf %s "$1" > {FOLDER}/plan.json', "sh", text])
        self.output("net", ["rm", "-f", f"{FOLDER}/ready"])
        files = {"plan": "plan.json", "counters": "counters.json", "ready-file": "ready"}
        command = [PYTHON, "-m", "net", "shape"]
        command += [word for option, file in files.items() for word in (f"--{option}", f"{FOLDER}/{file}")]
        script = ["sh", "-c", f'echo $$ > {FOLDER}/pid; exec "$@"', "sh", *command]
        with ThreadPoolExecutor(1) as thread:
            running = thread.submit(self.nodes["net"].exec_run, script, environment=self._environment())
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

    def _environment(self) -> Mapping[str, str]:
        links = self._topology.links
        return {
            "NODES": " ".join(f"{node}={subnet}.2,{subnet}.3" for node, subnet in self._subnets.items()),
            "LINKS": " ".join(f"{link.upper}-{link.lower}" for link in links),
        }

    def _container(self, name: str, node: str, last: int, **options: Any) -> Any:
        network = self._networks[node]
        place = {network.name: self._client.api.create_endpoint_config(ipv4_address=f"{self._subnets[node]}.{last}")}
        return self._client.containers.create(
            IMAGE, name=name, network=network.name, networking_config=place, entrypoint=["sleep", "infinity"],
            init=True, read_only=True, tmpfs={"/tmp": ""}, cap_drop=["ALL"],
            volumes={str(ROOT): {"bind": REPOSITORY, "mode": "ro"}},
            environment={"PYTHONPATH": f"{REPOSITORY}/services/net/src", "PYTHONDONTWRITEBYTECODE": "1"}, **options,
        )  # fmt: skip


_NET_SYSCTLS = {"ip_forward": 1, "conf.all.rp_filter": 0, "conf.default.rp_filter": 0}
