"""deploy/cluster unchanged, three RabbitMQ nodes behind HAProxy, as the cloud of a fleet with identities."""

from __future__ import annotations

import os
import secrets
import subprocess
from pathlib import Path
from typing import Self

import docker
from docker.models.containers import Container

from mqttxt import GroundStation
from mqttxt.security.authority import Authority
from mqttxt.security.broker import BrokerFiles
from mqttxt.security.rabbitmq import write
from mqttxt.security.rights import Rights
from testbed.bootstrap.docker import compose_command
from testbed.bootstrap.images import NODE
from tests.rigs.processes import ROOT, System, free_port, listens, wait_until
from tests.rigs.secure import SecureBroker

DEPLOY = ROOT / "deploy" / "cluster"
IMAGE = "mqttxt-cluster"
NODES = ("node1", "node2", "node3")
FORMING_S = 300.0
MEMBERS = ("broker-cloud", "broker-fog1", "fog1", "drone1", "drone2")


class Cluster:
    """The cloud of three nodes; one can be killed, frozen, or cut off from the other two but not from the balancer."""

    def __init__(self, folder: Path, members: tuple[str, ...] = MEMBERS, prefix: str = "") -> None:
        self.port = free_port()
        self.acme = Authority.create(folder / "acme", "acme")
        for name in members:
            self.acme.issue(name)
        self.acme.issue("gs-ops", Rights(None))
        identity, out = self.acme.folder / "broker-cloud", folder / "cluster"
        write(BrokerFiles(identity, prefix), out)
        cookie = out / "cookie"
        cookie.write_text(secrets.token_hex(32))
        cookie.chmod(0o400)
        if os.geteuid() == 0:
            for path in (identity, *identity.iterdir(), out, *out.iterdir()):
                os.chown(path, 1000, 1000)
        self._project = f"{IMAGE}-{self.port}"
        self._subnet = f"10.{secrets.randbelow(100) + 100}.{secrets.randbelow(256)}"
        self._environment = {
            **os.environ,
            **{"IDENTITY": str(identity), "CONFIGURATION": str(out), "LISTEN": f"127.0.0.1:{self.port}"},
            **{"COMPOSE_PROJECT_NAME": self._project, "SUBNET": self._subnet},
        }

    @property
    def url(self) -> str:
        return f"mqtts://localhost:{self.port}"

    def station(self) -> GroundStation:
        return GroundStation(self.url, identity=self.acme.folder / "gs-ops")

    def start(self) -> Self:
        build = ["docker", "build", "--quiet", "--network", "host", "--tag", IMAGE, str(DEPLOY)]
        subprocess.run(build, check=True, capture_output=True)
        self._compose("up", "--detach")
        self.wait_formed()
        self._control(NODES[0], "enable_feature_flag", "--experimental", "khepri_db")
        wait_until(lambda: listens(self.port), "the balancer listens")
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
        self._others(node, "--append")

    def join_again(self, node: str) -> None:
        self._others(node, "--delete")

    def _others(self, node: str, verb: str) -> None:
        """Add or delete rules, in a node's own network, that drop every packet between it and the others."""
        others = ",".join(f"{self._subnet}.{11 + number}" for number, each in enumerate(NODES) if each != node)
        rules = (f"iptables -w {verb} {way} {others} -j DROP" for way in ("INPUT -s", "OUTPUT -d"))
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

    def _control(self, node: str, *words: str) -> None:
        code, output = self._container(node).exec_run(["rabbitmqctl", "--quiet", *words])
        assert code == 0, output.decode()

    def _container(self, node: str) -> Container:
        return docker.from_env().containers.get(f"{self._project}_{node}_1")

    def _compose(self, *words: str) -> None:
        command = [*(compose_command() or ()), "-f", str(DEPLOY / "compose.yaml"), *words]
        done = subprocess.run(command, env=self._environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


class ClusteredSystem(System):
    """Two drones and their fog, with the cluster as the cloud's broker and TLS everywhere."""

    def __init__(self, folder: Path, cluster: Cluster) -> None:
        self._identities = cluster.acme.folder
        self.secured_fog = SecureBroker(cluster.acme, "broker-fog1")
        super().__init__(folder)
        fog = str(self.secured_fog.address)
        self.activator = self.make_activator(cluster.url, fog).with_more(*self._as("fog1"))
        self.uavs = {drone: self.make_uav(drone, fog).with_more(*self._as(f"drone{drone}")) for drone in self.uavs}

    def _as(self, name: str) -> tuple[str, str]:
        return "--identity", str(self._identities / name)

    @property
    def brokers(self) -> tuple[SecureBroker, ...]:  # type: ignore[override]
        return (self.secured_fog,)
