"""The machines besides this one on which a fleet is flown (MACHINES): the nodes of each, and its compose file.

This machine has the ground station, the cloud and `net`; each other one has some of the fogs, with their drones. The
networks of those nodes are overlays of a Docker Swarm. They lead to `net`, as all others do.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import yaml

from ..errors import UserError
from .compose import PROJECT, compose_text
from .fleet import Fleet

VARIABLE = "MACHINES"
_ADDRESS = re.compile(
    r"unix:///\S+|ssh://([A-Za-z0-9_][A-Za-z0-9_.-]*@)?[A-Za-z0-9][A-Za-z0-9_.-]*(:(?P<port>[0-9]{1,5}))?"
)
_PASSWORD = re.compile(r"(//[^/@:]*:).*@")
MAX_PORT = 65_535


@dataclass(frozen=True)
class Machine:
    """A machine: its Docker daemon's address, and the nodes that run there."""

    address: str
    nodes: tuple[str, ...]

    @property
    def name(self) -> str:
        """The machine's name in results: its address without the scheme."""
        return self.address.partition("://")[2]


def machines_of(environment: Mapping[str, str], fleet: Fleet) -> tuple[Machine, ...]:
    """The machines that MACHINES names; empty if it is not set.

    Each fog in turn, with its drones, is assigned to the machine that has the fewest drones so far. Raises UserError
    that names the address, or the number of machines, and what was expected.
    """
    addresses = [part.strip() for part in environment.get(VARIABLE, "").split(",") if part.strip()]
    for place, address in enumerate(addresses):
        found = _ADDRESS.fullmatch(address)
        if found is None or not 1 <= int(found["port"] or 22) <= MAX_PORT:
            shown = _PASSWORD.sub(r"\1***@", address)  # programs that run this may log it
            raise UserError(
                f"{VARIABLE}: {shown}: expected ssh://[USER@]HOST[:PORT] or unix:///PATH, a list with commas"
            )
        if address in addresses[:place]:
            raise UserError(f"{VARIABLE}: {address}: expected each machine once")
    if len(addresses) > len(fleet.fogs):
        raise UserError(
            f"{VARIABLE}: {len(addresses)} machines: expected no more than there are fogs, {len(fleet.fogs)} (FOGS)"
        )
    fogs: dict[str, list[int]] = {address: [] for address in addresses}
    for fog in fleet.fogs if addresses else ():
        fewest = min(addresses, key=lambda address: sum(len(fleet.fogs[one]) for one in fogs[address]))
        fogs[fewest].append(fog)
    return tuple(Machine(address, _nodes(fleet, placed)) for address, placed in fogs.items())


def _nodes(fleet: Fleet, fogs: Sequence[int]) -> tuple[str, ...]:
    drones = [drone for fog in fogs for drone in fleet.fogs[fog]]
    return (*(f"fog{fog}" for fog in fogs), *(f"uav{drone}" for drone in drones))


def refuse_machines(environment: Mapping[str, str], what: str) -> None:
    """Raise UserError if MACHINES is set for a command that uses only one machine."""
    if environment.get(VARIABLE):
        shown = _PASSWORD.sub(r"\1***@", environment[VARIABLE])
        raise UserError(f"{VARIABLE}={shown}: expected none for {what}, which uses this machine alone")


def overlay_of(node: str) -> str:
    """The name of the network between `net` and a node on another machine."""
    return f"{PROJECT}-{node}"


def volume_of(name: str) -> str:
    """The name on another machine of a volume of compose.yaml."""
    return f"{PROJECT}-{name}"


def volumes_of(fleet: Fleet) -> dict[str, dict[str, str]]:
    """The options of compose.yaml's volumes, by name."""
    volumes = _document(fleet)["volumes"]
    return {name: (volume or {}).get("driver_opts", {}) for name, volume in volumes.items()}


def compose_here(fleet: Fleet, machines: Sequence[Machine]) -> str:
    """The compose file of this machine, without the nodes of the other machines."""
    document = _document(fleet)
    there = {node for machine in machines for node in machine.nodes}
    services = {name: one for name, one in document["services"].items() if _node_of(name, one) not in there}
    networks = {name: one for name, one in document["networks"].items() if name not in there} | _overlays(there)
    return yaml.safe_dump({**document, "services": services, "networks": networks}, sort_keys=False)


def compose_there(fleet: Fleet, machine: Machine) -> str:
    """The compose file of another machine; its volumes and networks are made beforehand."""
    document = _document(fleet)
    services = {
        name: {key: value for key, value in one.items() if key != "depends_on"}
        for name, one in document["services"].items()
        if _node_of(name, one) in machine.nodes
    }
    volumes = {name: {"external": True, "name": volume_of(name)} for name in document["volumes"]}
    whole = {"services": services, "networks": _overlays(machine.nodes), "volumes": volumes}
    return yaml.safe_dump(whole, sort_keys=False)


def _document(fleet: Fleet) -> dict[str, Any]:
    return _parsed(compose_text(fleet))


@lru_cache(maxsize=1)
def _parsed(text: str) -> dict[str, Any]:
    """Parse compose.yaml's text. The result must not be changed: the files of all machines are made from it."""
    found: dict[str, Any] = yaml.safe_load(text)
    return {key: value for key, value in found.items() if not key.startswith("x-")}


def _node_of(name: str, service: Mapping[str, Any]) -> str:
    """The node that a service is or runs on."""
    return str(service.get("network_mode", f"service:{name}")).removeprefix("service:")


def _overlays(nodes: Sequence[str] | set[str]) -> dict[str, Any]:
    return {node: {"external": True, "name": overlay_of(node)} for node in sorted(nodes)}
