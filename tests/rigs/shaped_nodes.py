"""Nodes and `net` between them, in containers with compose.yaml's rights: tests shape real packets there."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import docker
from docker.types import IPAMConfig, IPAMPool

ROOT = Path(__file__).resolve().parents[2]
IMAGE = os.environ.get("NODE_IMAGE", "mqttxt-testbed/node:latest")
PYTHON = "/opt/venv/bin/python"
REPOSITORY = "/repository"
FOLDER = "/tmp/shaping"
READY_TIMEOUT_S = 30.0
_SHARED: dict[str, Any] = {
    **{"image": IMAGE, "entrypoint": ["sleep", "infinity"], "init": True, "read_only": True, "tmpfs": {"/tmp": ""}},
    **{"cap_drop": ["ALL"], "volumes": {str(ROOT): {"bind": REPOSITORY, "mode": "ro"}}},
    "environment": {"PYTHONPATH": f"{REPOSITORY}/services/net/src", "PYTHONDONTWRITEBYTECODE": "1"},
}


class ShapedNodes:
    """A container for each of `subnets` (the first three bytes of each node's), and `net`, which runs this source tree.

    `links` are those of `net`'s LINKS. A node is .3 of its subnet, `net` is .2 of each.
    """

    def __init__(self, name: str, subnets: Mapping[str, str], links: str) -> None:
        self._client = docker.from_env(timeout=120)
        self._name = f"mqttxt-{name}-{os.getpid()}"
        self._subnets = subnets
        self._links = links
        self._networks: dict[str, Any] = {}
        self.nodes: dict[str, Any] = {}

    def up(self) -> Self:
        """Start the containers, with the settings of compose.yaml's `node` and `net`."""
        for node, subnet in self._subnets.items():
            pool = IPAMPool(subnet=f"{subnet}.0/24")
            ipam = IPAMConfig(pool_configs=[pool])
            self._networks[node] = self._client.networks.create(f"{self._name}-{node}", ipam=ipam)
        first, *others = self._subnets
        routing = {f"net.ipv4.{name}": str(value) for name, value in _NET_SYSCTLS.items()}
        rights = ["NET_ADMIN", "NET_RAW", "DAC_OVERRIDE"]
        self._create("net", first, 2, cap_add=rights, sysctls=routing, mem_limit="512m", cpu_shares=4096)
        for node in others:
            self._networks[node].connect(self.nodes["net"], ipv4_address=f"{self._subnets[node]}.2")
        for node in self._subnets:
            forwarding = {"net.ipv4.ip_forward": "1"}
            self._create(node, node, 3, cap_add=["NET_ADMIN", "SYS_NICE"], sysctls=forwarding)
        for container in self.nodes.values():
            container.start()
        for node, subnet in self._subnets.items():
            self.output(node, ["ethtool", "-K", "eth0", "tso", "off", "gso", "off", "gro", "off", "tx", "off"])
            self.output(node, ["ip", "route", "replace", "default", "via", f"{subnet}.2"])
        return self

    def down(self) -> None:
        """Remove what `up` made, whole or not."""
        for container in self.nodes.values():
            container.remove(force=True)
        for network in self._networks.values():
            network.remove()
        self._client.close()

    def output(self, node: str, command: Sequence[str], **options: Any) -> str:
        """Run a command that has to succeed, and return its output."""
        code, said = self.nodes[node].exec_run(list(command), **options)
        assert code == 0, f"{node}: {' '.join(command)}: {said.decode()}"
        return str(said.decode())

    def write_plan(self, plan: object) -> None:
        """Write a plan of links for `shape_command`."""
        text = json.dumps(plan)
        self.output("net", ["sh", "-c", f'mkdir -p {FOLDER} && printf %s "$1" > {FOLDER}/plan.json', "sh", text])

    def shape_command(self, counters: str = f"{FOLDER}/counters.json") -> list[str]:
        """`net shape` on the plan that was written."""
        files = {"plan": f"{FOLDER}/plan.json", "counters": counters, "ready-file": f"{FOLDER}/ready"}
        return [PYTHON, "-m", "net", "shape", *(word for name, file in files.items() for word in (f"--{name}", file))]

    @property
    def environment(self) -> dict[str, str]:
        """The environment variables that describe the network to `net`."""
        nodes = " ".join(f"{node}={subnet}.2,{subnet}.3" for node, subnet in self._subnets.items())
        return {"NODES": nodes, "LINKS": self._links}

    def _create(self, name: str, node: str, last: int, **options: Any) -> None:
        """Create a container in a node's network, at the address that ends in `last`."""
        network = self._networks[node]
        place = {network.name: self._client.api.create_endpoint_config(ipv4_address=f"{self._subnets[node]}.{last}")}
        self.nodes[name] = self._client.containers.create(
            name=f"{self._name}-{name}-1", network=network.name, networking_config=place, **_SHARED, **options
        )


_NET_SYSCTLS = {"ip_forward": 1, "conf.all.rp_filter": 0, "conf.default.rp_filter": 0}
