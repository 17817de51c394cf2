"""The containers of a fleet over several machines, as one fleet: what `Containers` is for one machine."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from ...bootstrap.images import NODE
from ...errors import ContainerDied, DockerError, FleetError, UserError
from ...plan.experiments import Plan
from ...plan.fleet import Fleet
from ...plan.machines import VARIABLE, Machine, compose_here, compose_there, volumes_of
from ...plan.overrides import FLEET_COPY, compose_files
from ..containers import Containers, connect_docker, services_of
from .overlays import ROUTERS, Carrier, make_overlays, remove_overlays
from .reach import NET, Daemon, reached
from .swarm import forget, joined

FETCHED = "sitl"
"""What the nodes on other machines write into the run folder there."""
MISSION = "mission: "
PORTS = "UDP port 4789, and UDP and TCP port 7946,"
PONG, PING_S = "1 received", 15
"""What ping prints of an answer, and how many seconds one waits: less than Docker's client waits for output."""
PINGS = 5
"""For so long a swarm may not know its overlays: what gossip did not carry to a machine comes when it exchanges all
that it knows with another one, chosen at random every 30 s (moby/moby 47728 and 53437)."""
LISTENS_S, LISTENS_POLL_S = 60.0, 0.1
"""Within which the cloud's routers listen."""


@contextlib.contextmanager
def containers_on(plan: Plan) -> Iterator[Callable[..., Containers]]:
    """What makes a plan's containers on its machines, which are a swarm meanwhile.

    Raises UserError for a machine that cannot be used, DockerError where one could not be left as it was.
    """
    with reached(plan.machines, NODE) as daemons:
        here = connect_docker()
        with contextlib.closing(here), joined(here, daemons) as node_ids:
            yield functools.partial(SpreadContainers, daemons, node_ids)


class SpreadContainers(Containers):
    """Those of this machine by its own Docker, and those of each other machine by that one's.

    A machine that is lost in flight does not end the mission: the station is to hear of every command what became of
    it. The attempt fails once the mission has ended.
    """

    def __init__(
        self,
        daemons: Sequence[Daemon],
        node_ids: Mapping[str, str],
        profile: str,
        run_dir: Path,
        settings: dict[str, str],
        fleet: Fleet,
    ) -> None:
        compose_files(settings, fleet, run_dir)  # of which the copy of the fleet's file is needed
        machines = [daemon.machine for daemon in daemons]
        texts = [compose_here(fleet, machines), *(compose_there(fleet, machine) for machine in machines)]
        files = [run_dir / f"compose-{place}.yaml" for place in range(len(texts))]
        for path, text in zip(files, texts, strict=True):
            path.write_text(text, encoding="utf-8")
        super().__init__(profile, run_dir, settings, fleet, files=files[:1])
        there = settings | {"RUN_DIR": "live"}
        self._others = {
            daemon.name: Containers(profile, run_dir, there, fleet, daemon=daemon.address, files=[path])
            for daemon, path in zip(daemons, files[1:], strict=True)
        }
        self._carriers = {daemon.name: Carrier(daemon) for daemon in daemons}
        self._machines = machines
        self._nodes = [node for machine in machines for node in machine.nodes]
        self._services = {path: services_of(self._profiles, path) for path in files}
        self._files_there = dict(zip(self._others, files[1:], strict=True))
        self._fleet, self._run_dir, self._node_ids = fleet, run_dir, node_ids
        self._are_joined = False
        self._lost: dict[str, str] = {}

    @property
    def count(self) -> int:
        return super().count + sum(other.count for other in self._others.values())

    def up(self, *services: str) -> None:
        """Those of this machine first: the routers on the others wait until the cloud's listen."""
        if not self._are_joined:
            self._join()
        here, there = self._of(self._files[0], services), list(self._others)
        if here or not services:
            super().up(*here)
        if not services and "router-cloud" in self._services[self._files[0]]:
            self._pass_on_that_the_cloud_listens()
        with ThreadPoolExecutor(len(there)) as pool:
            list(pool.map(lambda name: self._up_there(name, services), there))

    def start(self, *services: str) -> None:
        """As on one machine. Raises UserError for a machine between whose nodes and `net` nothing passes."""
        super().start(*services)
        if NET in services:
            for machine in self._machines:
                self._check_way(machine)

    def _check_way(self, machine: Machine) -> None:
        node = machine.nodes[0]
        gateway = self._fleet.gateway(node)
        ping = ["ping", "-c", "1", "-w", str(PING_S), gateway]
        if not any(PONG in self.output(node, ping) for _ in range(PINGS)):
            said = f"no answer from net to {node} there within {PINGS * PING_S} s"
            raise UserError(f"{VARIABLE}: {machine.address}: {said}: expected {PORTS} to be open between all machines")

    def _up_there(self, name: str, services: Sequence[str]) -> None:
        own = self._of(self._files_there[name], services)
        if own or not services:
            with _named(name):
                self._others[name].up(*own)

    def _of(self, path: Path, services: Sequence[str]) -> list[str]:
        return [service for service in services if service in self._services[path]]

    def _join(self) -> None:
        make_overlays(self._client, self._fleet, self._nodes)
        volumes = volumes_of(self._fleet)
        with ThreadPoolExecutor(len(self._carriers)) as pool:
            list(pool.map(lambda carrier: carrier.start(NODE, volumes), self._carriers.values()))
        fleet_file = self._run_dir / FLEET_COPY
        if fleet_file.exists():
            for carrier in self._carriers.values():
                carrier.put(fleet_file)
        self._are_joined = True

    def _pass_on_that_the_cloud_listens(self) -> None:
        """What routers of one machine see in a volume."""
        deadline_s = time.monotonic() + LISTENS_S
        path = f"{ROUTERS}/cloud"
        while path not in self.output("router-cloud", ["ls", path]).split():
            self.check_alive()
            if time.monotonic() > deadline_s:
                raise FleetError(f"router-cloud does not listen within {LISTENS_S:g} s")
            time.sleep(LISTENS_POLL_S)
        for carrier in self._carriers.values():
            carrier.touch(path)

    def check_alive(self) -> None:
        """Raises ContainerDied for a container that has ended; a machine that is lost is kept in mind."""
        super().check_alive()
        for name, other in self._others.items():
            if name in self._lost:
                continue
            try:
                other.check_alive()
            except ContainerDied:
                raise
            except DockerError as error:
                self._lost[name] = str(error)

    def execute(
        self, service: str, command: list[str], *, limit_s: float, alive_every_s: float = 1.0
    ) -> Generator[str, None, int]:
        """As on one machine. Raises FleetError at the command's end where a machine was lost meanwhile."""
        running, said = super().execute(service, command, limit_s=limit_s, alive_every_s=alive_every_s), ""
        while True:
            try:
                line = next(running)
            except StopIteration as stop:
                code: int = stop.value
                break
            said = line if line.startswith(MISSION) else said
            yield line
        for name, why in self._lost.items():
            raise FleetError(f"{name} was lost in flight: {why}" + (f"; {said}" if said else ""))
        return code

    def save_logs(self, folder: Path) -> None:
        """The logs of all, and what nodes on other machines wrote into their run folders."""
        with contextlib.ExitStack() as last_first:
            for name, carrier in self._carriers.items():
                if name not in self._lost:
                    last_first.callback(carrier.fetch, FETCHED, self._run_dir)
            last_first.callback(super().save_logs, folder)

    def down(self) -> None:
        """Everything on every machine, and the overlays between them."""
        with contextlib.ExitStack() as last_first:
            last_first.callback(remove_overlays, self._client)
            for name in self._lost:
                last_first.callback(forget, self._client, self._node_ids[name])
            for name, other in self._others.items():
                if name not in self._lost:
                    last_first.callback(self._carriers[name].remove)
                    last_first.callback(_down_there, name, other)
            last_first.callback(super().down)
        self._are_joined = False

    def _all(self) -> list[Any]:
        there = [other for name, other in self._others.items() if name not in self._lost]
        return [*super()._all(), *(container for other in there for container in other._all())]


def _down_there(name: str, containers: Containers) -> None:
    with _named(name):
        containers.down()


@contextlib.contextmanager
def _named(name: str) -> Iterator[None]:
    """Errors say on which machine."""
    try:
        yield
    except DockerError as error:
        raise type(error)(f"{name}: {error}") from error
