"""The topology: nodes with their addresses, and the links between them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

Names = tuple[int | str, ...]
LINK_CLASSES = ("wan", "backhaul", "air", "sense")
"""The first parts of links' names, from the ground station outwards."""


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
    """Nodes and links, from the ground station outwards."""

    nodes: tuple[Node, ...]
    links: tuple[Link, ...]

    @cached_property
    def ends(self) -> dict[str, tuple[str, str]]:
        """The nodes from which and to which each directed link leads, by its name, as `air:uav1:up`."""
        found = {}
        for link in self.links:
            found[f"{link.name}:up"] = (link.lower, link.upper)
            found[f"{link.name}:down"] = (link.upper, link.lower)
        return found

    def name_of(self, address: str) -> str | None:
        return next((node.name for node in self.nodes if node.address == address), None)

    def link_of(self, source: str, destination: str) -> str | None:
        """The directed link between two neighbours; None for any other pair."""
        return next((name for name, ends in self.ends.items() if ends == (source, destination)), None)


def place_of_link(name: str) -> tuple[int, Names]:
    """The key that sorts links and their directions: wan, backhaul, air, sense; up before down."""
    kind = name.split(":")[0]
    place = LINK_CLASSES.index(kind) if kind in LINK_CLASSES else len(LINK_CLASSES)
    return place, by_number(name.replace(":down", ":~"))


def by_number(name: str) -> Names:
    """The key that sorts uav2 before uav10."""
    return tuple(int(part) if part.isdecimal() else part for part in re.split("([0-9]+)", name))
