"""A fleet, and all that is derived from it: nodes, addresses, links, the routers of its MAVLink chains."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from ipaddress import IPv4Network
from typing import Any

from .topology import Link, Node, Topology

MOST_DRONES = 250
"""The highest of MAVLink's system ids for vehicles."""
MOST_ROUTED = 48
"""The highest number of a drone with routers: each of its four has its own system id, from 1 to 240."""
FIRST_PORT = 14540
"""The UDP port of a shared chain; that of drone N's own chain is N more."""
AUTOPILOT_PORT = 14580
"""Drone N's autopilot listens on this port plus N."""
HEADQUARTERS = ("gs", "cloud")
"""The nodes that each fleet has exactly once."""
_NET_HOST, _NODE_HOST = 2, 3
_LEVELS = ("gs", "cloud", "fog", "uav")
_LAST_ROUTER_ID, _FEWEST_IDS = 240, 10
"""MAVSDK is system 245. Each level has at least ten ids, so that those of a small fleet are easy to read."""


@dataclass(frozen=True)
class Fleet:
    """Fogs with their drones; the first network of each kind of node; and the file's entry of each drone.

    fogs            each fog's drones by the fog's number; drones are numbered from 1 to 250
    networks        those of gs and cloud; for fogs, drones and sensors that of number 1, followed by those of 2, 3, …
    drones          by number: home, battery and PX4's parameters as the stand-ins take them, endurance_s and point
    parameters      PX4's, for all drones
    sensor_range_m  the distance in metres from its drone's point up to which a sensor can be received
    """

    fogs: Mapping[int, tuple[int, ...]]
    networks: Mapping[str, IPv4Network]
    drones: Mapping[int, Mapping[str, Any]]
    parameters: Mapping[str, float]
    sensor_range_m: float

    @cached_property
    def fog_of(self) -> dict[int, int]:
        """Each drone's fog; the drones are in the order of the fogs."""
        return {drone: fog for fog, drones in self.fogs.items() for drone in drones}

    @property
    def flown(self) -> str:
        """Fogs and drones for the mission's option: 1:1,2,3;2:4,5,6."""
        return ";".join(f"{fog}:{','.join(str(drone) for drone in drones)}" for fog, drones in self.fogs.items())

    @property
    def one(self) -> dict[int, tuple[int, ...]]:
        """The fog and the drone whose messages the message set counts."""
        fog, drones = next(iter(self.fogs.items()))
        return {fog: drones[:1]}

    def nodes(self, *, sensors: bool = False) -> list[str]:
        """The nodes' names from the station outwards, with the sensors' nodes or without."""
        names = [*HEADQUARTERS, *(f"fog{fog}" for fog in self.fogs), *(f"uav{drone}" for drone in self.fog_of)]
        return [*names, *(f"sensor{drone}" for drone in self.fog_of)] if sensors else names

    def network(self, node: str) -> IPv4Network:
        """The network between a node and `net`."""
        if node in HEADQUARTERS:
            return self.networks[node]
        kind = node.rstrip("0123456789")
        first = self.networks[{"fog": "fogs", "uav": "drones", "sensor": "sensors"}[kind]]
        before = int(node.removeprefix(kind)) - 1
        return IPv4Network((int(first.network_address) + before * first.num_addresses, first.prefixlen))

    def address(self, node: str) -> str:
        return str(self.network(node)[_NODE_HOST])

    def gateway(self, node: str) -> str:
        """The address of `net` towards a node."""
        return str(self.network(node)[_NET_HOST])

    def broker_url(self, node: str, *, secured: bool = False) -> str:
        """The URL of the broker on a node, as other nodes reach it; `secured`: in TLS."""
        return f"{'mqtts' if secured else 'mqtt'}://{self.address(node)}:{8883 if secured else 1883}"

    def topology(self, *, sensors: bool = False) -> Topology:
        """Nodes and links, with the sensors' or without."""
        nodes = tuple(Node(name, self.address(name)) for name in self.nodes(sensors=sensors))
        return Topology(nodes, tuple(self._links(sensors)))

    def _links(self, sensors: bool) -> Iterator[Link]:
        yield Link("wan:gs", "gs", "cloud")
        yield from (Link(f"backhaul:fog{fog}", f"fog{fog}", "cloud") for fog in self.fogs)
        yield from (Link(f"air:uav{drone}", f"uav{drone}", f"fog{fog}") for drone, fog in self.fog_of.items())
        if sensors:
            yield from (Link(f"sense:uav{drone}", f"sensor{drone}", f"uav{drone}") for drone in self.fog_of)

    @property
    def has_routers(self) -> bool:
        """Whether MAVLink's system ids suffice for the drones and the routers of their chains."""
        return max(self.fog_of) <= MOST_ROUTED

    def behind(self, node: str) -> tuple[int, ...]:
        """The drones whose chains lead over a node."""
        if node in HEADQUARTERS:
            return tuple(self.fog_of)
        if node.startswith("fog"):
            return self.fogs[int(node.removeprefix("fog"))]
        return (int(node.removeprefix("uav")),)

    def towards_station(self, node: str) -> str | None:
        """The next node on the way from a node to the ground station; None for the station itself."""
        if node in HEADQUARTERS:
            return "gs" if node == "cloud" else None
        return "cloud" if node.startswith("fog") else f"fog{self.fog_of[self.behind(node)[0]]}"

    def routers(self, node: str, *, shared: bool) -> list[str]:
        """mavp2p's arguments for each router of a node: listen towards the autopilot, send towards the station."""
        above, drones = self.towards_station(node), self.behind(node)
        here = "127.0.0.1" if node.startswith("uav") else self.address(node)
        there = "127.0.0.1" if above is None else self.address(above)
        found = []
        for drone in drones[:1] if shared else drones:
            own, chain = FIRST_PORT + drone, FIRST_PORT if shared else FIRST_PORT + drone
            listen = own if node.startswith("uav") else chain
            found.append(f"udps:{here}:{listen} udpc:{there}:{chain} --hb-systemid={self._router_id(node, drone)}")
        return found

    def _router_id(self, node: str, drone: int) -> int:
        level = _LEVELS.index(node.rstrip("0123456789"))
        each = max(_FEWEST_IDS, *self.fog_of)
        return _LAST_ROUTER_ID - each * (len(_LEVELS) - level) + drone

    def to_data(self) -> dict[str, Any]:
        """The content of the fleet's file."""
        return {
            "fogs": {fog: list(drones) for fog, drones in self.fogs.items()},
            "addresses": {name: str(network) for name, network in self.networks.items()},
            "sensor_range_m": self.sensor_range_m,
            "parameters": dict(self.parameters),
            "drones": {drone: dict(entry) for drone, entry in sorted(self.drones.items())},
        }
