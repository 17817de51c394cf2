"""Nodes and `net` between them, in containers with compose.yaml's rights: tests shape real packets there."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import docker
from docker.types import IPAMConfig, IPAMPool

from tests.rigs.loopback import wait_until

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

    def __enter__(self) -> Self:
        try:
            return self.up()
        except BaseException:
            self.down()
            raise

    def __exit__(self, *_: object) -> None:
        self.down()

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


class Running:
    """A program that shapes, in `net`; it runs while this is entered."""

    def __init__(self, net: ShapedNodes, command: Sequence[str]) -> None:
        self._net, self._command = net, " ".join(command)
        self._pid = ""

    def __enter__(self) -> Self:
        self._net.output("net", ["rm", "-f", f"{FOLDER}/ready", f"{FOLDER}/log"])
        script = f"{self._command} > {FOLDER}/log 2>&1 & echo $! > {FOLDER}/pid; wait"
        self._net.nodes["net"].exec_run(["sh", "-c", script], environment=self._net.environment, detach=True)
        try:
            wait_until(lambda: self._is_there(f"{FOLDER}/ready"), "it is ready", READY_TIMEOUT_S)
        except AssertionError as error:
            raise AssertionError(f"{error}: {self._net.output('net', ['cat', f'{FOLDER}/log'])}") from None
        self._pid = self._net.output("net", ["cat", f"{FOLDER}/pid"]).strip()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def signal(self, name: str) -> None:
        self._net.output("net", ["sh", "-c", f"kill -{name} {self._pid}"])

    def end(self) -> dict[str, Any]:
        """End it and return its counters; may be called again."""
        if self._is_there(f"/proc/{self._pid}"):
            self.signal("TERM")
        self.wait_until_ended()
        return self.counters()

    def wait_until_ended(self) -> None:
        wait_until(lambda: not self._is_there(f"/proc/{self._pid}"), "it has ended", READY_TIMEOUT_S)

    def counters(self) -> dict[str, Any]:
        """The counters in their file at present."""
        content: dict[str, Any] = json.loads(self.read("counters.json"))
        return content

    def read(self, name: str) -> str:
        """The text of a file in its folder."""
        return self._net.output("net", ["cat", f"{FOLDER}/{name}"])

    def _is_there(self, path: str) -> bool:
        return bool(self._net.nodes["net"].exec_run(["test", "-e", path]).exit_code == 0)


_NET_SYSCTLS = {"ip_forward": 1, "conf.all.rp_filter": 0, "conf.default.rp_filter": 0}
