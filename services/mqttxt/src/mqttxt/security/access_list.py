"""Who may publish and hear what at a broker: Mosquitto's access list, made from the table of topics.

Deny by default. Each member of the fleet has an entry of its own, by the name in its certificate: who has no entry
hears nothing and is heard by nobody, whatever it subscribes to.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product

from ..errors import ConfigurationError
from ..protocol.bulk import BulkAsk
from ..protocol.control import Grant
from ..protocol.messages import CommandMessage
from ..protocol.rankings import SelectMessage
from ..protocol.topic_table import (
    ACTIVATOR,
    ACTIVATORS,
    CLOUD_NODES,
    CLOUD_SIDE,
    FOG_NODES,
    FOG_SIDE,
    SENSOR,
    SENSOR_SIDE,
    SENSORS,
    STATION,
    STATIONS,
    UAV,
    TopicRow,
)
from ..protocol.topics import MAVLINK_STATE, CloudSide
from .certificate import Certificate
from .names import Kind, NodeName
from .rights import Rights

CLOUD = "cloud"
_KINDS = {
    Kind.STATION: (STATION, STATIONS, CLOUD_NODES),
    Kind.FOG: (ACTIVATOR, ACTIVATORS, CLOUD_NODES, FOG_NODES),
    Kind.DRONE: (UAV, FOG_NODES),
    Kind.SENSOR: (SENSOR, SENSORS),
}
_COMMANDING = (CommandMessage, SelectMessage, Grant, BulkAsk)
OWN_BEACON = "fogX/clock"


@dataclass(frozen=True)
class Entry:
    """What one node may do with the topics that match a filter; neither: it may not, whatever other entries say."""

    filter: str
    publish: bool
    hear: bool

    def __str__(self) -> str:
        allowed = (("write", self.publish), ("read", self.hear))
        access = "".join(reversed([word for word, is_allowed in allowed if is_allowed])) or "deny"
        return f"topic {access} {self.filter}"


@dataclass(frozen=True)
class Place:
    """Which broker it is: the cloud's, with the prefix of its topics, or that of a fog or drone, by its number.

    `fogs` have the cloud's broker as theirs too. `air`: the fog's drones come through its activator, which then may
    what they may; what they say is signed by themselves.
    """

    kind: str
    number: int = 0
    prefix: str = ""
    fogs: frozenset[int] = frozenset()
    air: bool = False

    @classmethod
    def of_broker(cls, name: NodeName, prefix: str = "", fogs: frozenset[int] = frozenset()) -> Place:
        """By the broker's own name: `broker-cloud`, `broker-fog1`, `broker-drone3`; raises ConfigurationError."""
        if name.label == CLOUD:
            return cls(CLOUD, prefix=prefix, fogs=fogs)
        node = NodeName.parse(name.label)
        if name.kind is not Kind.BROKER or node.kind not in (Kind.FOG, Kind.DRONE):
            raise ConfigurationError(f"{name}: expected broker-cloud, broker-fogX or broker-droneY")
        return cls(node.kind, node.number)

    @property
    def rows(self) -> tuple[TopicRow, ...]:
        return {CLOUD: CLOUD_SIDE, Kind.FOG: FOG_SIDE, Kind.DRONE: SENSOR_SIDE}[self.kind]

    def has(self, node: NodeName) -> bool:
        """Whether a node connects to this broker: a fog's and a drone's own broker have one of these alone."""
        return self.kind == CLOUD or node.kind != self.kind or node.number == self.number


def entries(place: Place, node: NodeName, rights: Rights, fogs: Iterable[NodeName]) -> list[Entry]:
    """What a node may publish and hear at a broker of a fleet with these fogs."""
    if node.kind not in _KINDS or not place.has(node) or (node.kind is Kind.STATION and rights == Rights()):
        return []
    carried = (UAV,) if place.air and node.kind is Kind.FOG else ()
    found = _of_rows(place.rows, place.prefix, node, rights, fogs, carried)
    for fog in sorted(place.fogs):
        root = CloudSide(fog, place.prefix).local_root()
        if node.kind is Kind.DRONE or node == NodeName(Kind.FOG, fog):
            found += _of_rows(FOG_SIDE, root, node, rights, fogs)
        elif node.kind is Kind.STATION:  # the filter of readings would let it hear some of it
            found.append(Entry(f"{root}#", publish=False, hear=False))
    return found


def _of_rows(
    rows: Iterable[TopicRow],
    root: str,
    node: NodeName,
    rights: Rights,
    fogs: Iterable[NodeName],
    carried: tuple[str, ...] = (),
) -> list[Entry]:
    """What a node may do with the topics of some rows of the table, below a root; it may what it `carried` may."""
    names = (*_KINDS[node.kind], *carried)
    found: dict[str, Entry] = {}
    for row in rows:
        publish, hear = row.sender in names, row.receiver in names
        for topic in _filters(row, node, rights, fogs) if publish or hear else ():
            found[topic] = Entry(root + topic, publish, hear or _is_watched(row))
    return list(found.values())


def _is_watched(row: TopicRow) -> bool:
    """Whether its sender hears it too: what it retains (R9.1), and an activator its beacon (R9.6)."""
    return row.retained or (row.sender == ACTIVATOR and row.topic == OWN_BEACON)


def access_list(place: Place, members: Iterable[Certificate]) -> str:
    """The file, for the certificates of those who may use the broker."""
    lines = ["# Made by `mqttxt broker`: make it again instead of changing it.", ""]
    for node, given in entries_of_all(place, members):
        lines += [f"user {node}", *(str(entry) for entry in given), ""]
    return "\n".join(lines)


def entries_of_all(place: Place, members: Iterable[Certificate]) -> Iterator[tuple[NodeName, list[Entry]]]:
    """Each member that may do anything at the broker, by name.

    While two certificates of a name are valid, the rights of the newer one count.
    """
    rights = {each.node: each.rights for each in sorted(members, key=lambda each: each.not_before_s)}
    fogs = [node for node in rights if node.kind is Kind.FOG]
    for node in sorted(rights, key=str):
        if given := entries(place, node, rights[node], fogs):
            yield node, given


def _filters(row: TopicRow, node: NodeName, rights: Rights, fogs: Iterable[NodeName]) -> Iterator[str]:
    """The filters that cover a row of the table for a node: a level that names a node is the node itself, or any."""
    if node.kind is Kind.STATION and row.payload in _COMMANDING:
        if rights.command == frozenset():
            return
        drones = ["+"] if rights.command is None else [f"drone{drone}" for drone in sorted(rights.command)]
    else:
        drones = [str(node)] if node.kind is Kind.DRONE else ["+"]
    levels = {
        "fogX": [str(node)] if node.kind is Kind.FOG else [str(fog) for fog in fogs],
        "droneY": drones,
        "sensorS": [str(node)] if node.kind is Kind.SENSOR else ["+"],
        "G": [node.label] if node.kind is Kind.STATION else ["+"],
        "Z": ["+", f"{MAVLINK_STATE}+"],
        "C": ["+"],
        "K": ["+"],
    }
    for chosen in product(*(levels.get(level, [level]) for level in row.topic.split("/"))):
        yield "/".join(chosen)
