"""deploy/cluster unchanged, three RabbitMQ nodes behind HAProxy, as the cloud of fleets with identities."""

from __future__ import annotations

import asyncio
import os
import secrets
import shutil
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Self

import docker
from docker.models.containers import Container

from mqttxt import GroundStation
from mqttxt.core.address import BrokerAddress
from mqttxt.security.authority import Authority
from mqttxt.security.broker import BrokerFiles
from mqttxt.security.rabbitmq import FLEETS, write
from mqttxt.security.rights import Rights
from testbed.bootstrap.docker import compose_command
from testbed.bootstrap.images import NODE
from tests.rigs.processes import ROOT, System, free_block, listens, wait_until
from tests.rigs.secure import SecureBroker

DEPLOY = ROOT / "deploy" / "cluster"
IMAGE = "mqttxt-cluster"
NODES = ("node1", "node2", "node3")
FORMING_S = 300.0
MEMBERS = ("broker-fog1", "fog1", "drone1", "drone2")
PORTS = range(8883, 8893)
"""What the balancer listens at, a port for each fleet."""


@dataclass(frozen=True)
class Carried:
    """A fleet that the cluster carries; `inner_port` is that of its listeners at the nodes."""

    authority: Authority
    prefix: str
    inner_port: int
    url: str

    @property
    def address(self) -> BrokerAddress:
        return BrokerAddress.parse(self.url)

    def identity(self, name: str) -> Path:
        return self.authority.folder / name

    def station(self, name: str = "gs-ops") -> GroundStation:
        return GroundStation(self.url, prefix=self.prefix, identity=self.identity(name))


class Cluster:
    """The cloud of three nodes; one can be killed, frozen, or cut off from the other two but not from the balancer."""

    def __init__(self, folder: Path) -> None:
        self.fleets: dict[str, Carried] = {}
        self._folder, self._out = folder, folder / "cluster"
        self._out.mkdir()
        cookie = self._out / "cookie"
        cookie.write_text(secrets.token_hex(32))
        cookie.chmod(0o400)
        self._port = free_block(len(PORTS))
        self._project = f"{IMAGE}-{self._port}"
        self._subnet = f"10.{secrets.randbelow(100) + 100}.{secrets.randbelow(256)}"
        self._environment = {
            **os.environ,
            **{"CONFIGURATION": str(self._out), "LISTEN": f"127.0.0.1:{self._port}-{self._port + len(PORTS) - 1}"},
            **{"COMPOSE_PROJECT_NAME": self._project, "SUBNET": self._subnet},
        }

    def add(self, name: str = "acme", members: tuple[str, ...] = MEMBERS, prefix: str = "") -> Carried:
        """Add a fleet with an authority of its own and the station `gs-ops`; a running cluster has to be told."""
        authority = Authority.create(self._folder / name, name)
        for member in ("broker-cloud", *members):
            authority.issue(member)
        authority.issue("gs-ops", Rights(None))
        place = len(self.fleets)
        url = f"mqtts://localhost:{self._port + place}"
        self.fleets[name] = Carried(authority, prefix, PORTS[place], url)
        self.write(name)
        return self.fleets[name]

    def write(self, name: str) -> None:
        """Write a fleet's present members, as `mqttxt broker` does."""
        fleet = self.fleets[name]
        write(BrokerFiles(fleet.identity("broker-cloud"), fleet.prefix), self._out, fleet.inner_port)
        if os.geteuid() == 0:
            for path in (self._out, *self._out.rglob("*")):
                os.chown(path, 1000, 1000)

    def take_out(self, name: str) -> None:
        """Delete a fleet's folder, so that the nodes stop to serve it."""
        shutil.rmtree(self.folder_of(name))

    def folder_of(self, name: str) -> Path:
        return self._out / FLEETS / name

    def tell(self) -> None:
        """Bring the running nodes what was written."""
        self.control(NODES[0], "import_definitions", "/configuration/definitions.json")

    def start(self) -> Self:
        build = ["docker", "build", "--quiet", "--network", "host", "--tag", IMAGE, str(DEPLOY)]
        subprocess.run(build, check=True, capture_output=True)
        self._compose("up", "--detach")
        self.wait_formed()
        self.control(NODES[0], "enable_feature_flag", "--experimental", "khepri_db")
        wait_until(lambda: listens(self._port), "the balancer listens")
        return self

    def wait_formed(self) -> None:
        """Wait until all three nodes run and each sees the others."""
        for node in NODES:
            wait_until(lambda node=node: self._is_formed(node), f"{node} knows of all", FORMING_S)

    def close(self) -> None:
        self._compose("down", "--timeout", "3", "--volumes")

    def containers(self) -> list[Container]:
        """The containers of the nodes and the balancer."""
        return [self._container(name) for name in (*NODES, "balancer")]

    def kill(self, node: str) -> None:
        self._container(node).kill()

    def start_again(self, node: str) -> None:
        self._container(node).start()

    def freeze(self, node: str) -> None:
        self._container(node).pause()

    def thaw(self, node: str) -> None:
        self._container(node).unpause()

    def cut_off(self, node: str) -> None:
        self._between(node, set(NODES) - {node}, "--append")

    def join_again(self, node: str) -> None:
        self._between(node, set(NODES) - {node}, "--delete")

    def cut_link(self, node: str, other: str) -> None:
        self._between(node, {other}, "--append")

    def mend_link(self, node: str, other: str) -> None:
        self._between(node, {other}, "--delete")

    def serves(self, node: str) -> bool:
        """Whether a node takes clients, by what it sees of the others."""
        return self.control(node, "eval", "persistent_term:get(majority).").strip() == "true"

    def said(self, name: str, since: datetime) -> str:
        """What a node, or the balancer, has printed since a moment."""
        return str(self._container(name).logs(since=since.timestamp()).decode())

    def node_of(self, user: str) -> str | None:
        """The node that a user is connected to."""
        count = f'length([X || X <- rabbit_connection_tracking:list_on_node(node()), element(11, X) =:= <<"{user}">>]).'
        return next((node for node in NODES if self.control(node, "eval", count).strip() != "0"), None)

    def _between(self, node: str, others: set[str], verb: str) -> None:
        """Add or delete rules, in a node's own network, that drop every packet between it and the others."""
        far = ",".join(f"{self._subnet}.{11 + NODES.index(each)}" for each in sorted(others))
        rules = (f"iptables -w {verb} {way} {far} -j DROP" for way in ("INPUT -s", "OUTPUT -d"))
        docker.from_env().containers.run(
            NODE,
            entrypoint=["sh", "-ec"],
            command=["; ".join(rules)],
            network_mode=f"container:{self._container(node).id}",
            cap_drop=["ALL"],
            cap_add=["NET_ADMIN"],
            user="root",
            remove=True,
        )

    def _is_formed(self, node: str) -> bool:
        container = self._container(node)
        if container.status != "running":
            return False
        code, _ = container.exec_run(["rabbitmqctl", "--quiet", "await_online_nodes", "3", "--timeout", "10"])
        return bool(code == 0)

    def control(self, node: str, *words: str) -> str:
        """Run `rabbitmqctl` on a node; returns what it prints."""
        code, output = self._container(node).exec_run(["rabbitmqctl", "--quiet", *words])
        assert code == 0, output.decode()
        said: str = output.decode()
        return said

    def _container(self, node: str) -> Container:
        return docker.from_env().containers.get(f"{self._project}_{node}_1")

    def _compose(self, *words: str) -> None:
        command = [*(compose_command() or ()), "-f", str(DEPLOY / "compose.yaml"), *words]
        done = subprocess.run(command, env=self._environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


class ClusteredSystem(System):
    """Two drones and their fog, with the cluster as the cloud's broker and TLS everywhere."""

    def __init__(self, folder: Path, fleet: Carried) -> None:
        self._fleet = fleet
        self.secured_fog = SecureBroker(fleet.authority, "broker-fog1")
        super().__init__(folder)
        fog = str(self.secured_fog.address)
        own = ("--prefix", fleet.prefix, *self._as("fog1"))
        self.activator = self.make_activator(fleet.url, fog).with_more(*own)
        self.uavs = {drone: self.make_uav(drone, fog).with_more(*self._as(f"drone{drone}")) for drone in self.uavs}

    @classmethod
    @asynccontextmanager
    async def running(cls, folder: Path, fleet: Carried) -> AsyncIterator[Self]:
        """A fleet's system, from its start to its end."""
        system = cls(folder, fleet)
        try:
            yield await asyncio.to_thread(system.start)
        finally:
            await asyncio.to_thread(system.close)

    def _as(self, name: str) -> tuple[str, str]:
        return "--identity", str(self._fleet.identity(name))

    @property
    def brokers(self) -> tuple[SecureBroker, ...]:  # type: ignore[override]
        return (self.secured_fog,)
