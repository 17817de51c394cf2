"""The topology: nodes with their addresses, read from compose.yaml, and the links between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from ..errors import UserError

ROOT = Path(__file__).resolve().parents[2]
COMPOSE_FILE = ROOT / "compose.yaml"
SENSOR = "sensor"
"""How the names of the sensors' nodes begin; a number follows, that of the UAV which it is for."""
FLEET = {1: (1, 2, 3), 2: (4, 5, 6)}
"""Which fog has which drones; the addresses in compose.yaml's commands follow it."""


LINK_CLASSES = ("wan", "backhaul", "air", "sense")
"""How the names of links begin, from the ground station outwards."""


@dataclass(frozen=True)
class Node:
    """A node and its address."""

    name: str
    address: str


@dataclass(frozen=True)
class Link:
    """A link between a node and the next one towards the cloud; up is towards the cloud."""

    name: str
    lower: str
    upper: str


@dataclass(frozen=True)
class Topology:
    """Nodes and links, in the order in which people think of them."""

    nodes: tuple[Node, ...]
    links: tuple[Link, ...]

    def name_of(self, address: str) -> str | None:
        return next((node.name for node in self.nodes if node.address == address), None)

    def link_of(self, source: str, destination: str) -> str | None:
        """`air:uav1:up` for a pair of neighbours, None for any other pair."""
        for link in self.links:
            if (source, destination) == (link.lower, link.upper):
                return f"{link.name}:up"
            if (source, destination) == (link.upper, link.lower):
                return f"{link.name}:down"
        return None


def links_of(names: list[str], fleet: dict[int, tuple[int, ...]] | None = None) -> tuple[Link, ...]:
    """wan gs-cloud, backhaul cloud-fogX, air fogX-uavY, sense uavY-sensorY, for the nodes that are there."""
    chosen = fleet if fleet is not None else FLEET
    links = [Link("wan:gs", "gs", "cloud")]
    links += [Link(f"backhaul:fog{fog}", f"fog{fog}", "cloud") for fog in chosen]
    links += [Link(f"air:uav{drone}", f"uav{drone}", f"fog{fog}") for fog, drones in chosen.items() for drone in drones]
    links += [
        Link(f"sense:uav{drone}", f"sensor{drone}", f"uav{drone}") for drones in chosen.values() for drone in drones
    ]
    return tuple(link for link in links if link.lower in names and link.upper in names)


def place_of_link(name: str) -> tuple[int, str]:
    """Where a link or one of its directions comes in a list: wan, backhaul, air, sense; up before down."""
    kind = name.split(":")[0]
    place = LINK_CLASSES.index(kind) if kind in LINK_CLASSES else len(LINK_CLASSES)
    return place, name.replace(":down", ":~")


def read_topology(path: Path = COMPOSE_FILE, *, sensors: bool = False) -> Topology:
    """The topology of a compose file, with the sensors' nodes or without.

    Raises UserError where a node's address cannot be told.
    """
    nodes = []
    for name, service in read_services(path).items():
        networks = service.get("networks")
        if name == "net" or not isinstance(networks, dict) or (name.startswith(SENSOR) and not sensors):
            continue
        addresses = [config["ipv4_address"] for config in networks.values() if config]
        if len(addresses) != 1:
            raise UserError(f"{path}: services.{name}.networks: expected one network with an ipv4_address")
        nodes.append(Node(name, addresses[0]))
    return Topology(tuple(nodes), links_of([node.name for node in nodes]))


def read_services(path: Path = COMPOSE_FILE) -> dict[str, Any]:
    """The services of a compose file by name; raises UserError where there are none."""
    try:
        return _services_in(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
        raise UserError(f"{path}: expected a compose file with services: {' '.join(str(error).split())}") from error


@lru_cache(maxsize=4)
def _services_in(text: str) -> dict[str, Any]:
    """Read once: a run asks for its topology at every step, and aliases make the file ten times as long."""
    services: dict[str, Any] = yaml.load(text, yaml.CSafeLoader)["services"]
    return services
