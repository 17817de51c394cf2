"""The right to publish and receive at a broker: Mosquitto's access list, made from the table of topics.

Deny by default. Each member of the fleet has entries of its own, by the name in its certificate. A client without
entries receives nothing, whatever it subscribes to, and nothing that it publishes is delivered.
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
    """A node's rights to the topics of a filter; with neither right it is denied them, whatever other entries say."""

    filter: str
    publish: bool
    hear: bool

    def __str__(self) -> str:
        allowed = (("write", self.publish), ("read", self.hear))
        access = "".join(reversed([word for word, is_allowed in allowed if is_allowed])) or "deny"
        return f"topic {access} {self.filter}"


@dataclass(frozen=True)
class Place:
    """The place of a broker: the cloud, with the prefix of its topics, or a fog or a drone, by its number.

    `fogs` use the cloud's broker as theirs too. `air`: the fog's drones connect through its activator, which then has
    their rights; their messages are signed by the drones themselves.
    """

    kind: str
    number: int = 0
    prefix: str = ""
    fogs: frozenset[int] = frozenset()
    air: bool = False

    @classmethod
    def of_broker(cls, name: NodeName, prefix: str = "", fogs: frozenset[int] = frozenset()) -> Place:
        """Parse a broker's name: `broker-cloud`, `broker-fog1`, `broker-drone3`; raises ConfigurationError."""
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
        """Whether a node connects to this broker: at a fog's or a drone's own, of this kind only that node does."""
        return self.kind == CLOUD or node.kind != self.kind or node.number == self.number


def entries(place: Place, node: NodeName, rights: Rights, fogs: Iterable[NodeName]) -> list[Entry]:
    """The entries of a node at a broker, in a fleet with these fogs."""
    if node.kind not in _KINDS or not place.has(node) or (node.kind is Kind.STATION and rights == Rights()):
        return []
    carried = (UAV,) if place.air and node.kind is Kind.FOG else ()
    found = _of_rows(place.rows, place.prefix, node, rights, fogs, carried)
    for fog in sorted(place.fogs):
        root = CloudSide(fog, place.prefix).local_root()
        if node.kind is Kind.DRONE or node == NodeName(Kind.FOG, fog):
            found += _of_rows(FOG_SIDE, root, node, rights, fogs)
        elif node.kind is Kind.STATION:  # its filter for readings would match some of these topics
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
    """The entries of a node for rows of the table below a root, including the rights of those that it `carried`."""
    names = (*_KINDS[node.kind], *carried)
    found: dict[str, Entry] = {}
    for row in rows:
        publish, hear = row.sender in names, row.receiver in names
        for topic in _filters(row, node, rights, fogs) if publish or hear else ():
            found[topic] = Entry(root + topic, publish, hear or _is_watched(row))
    return list(found.values())


def _is_watched(row: TopicRow) -> bool:
    """Whether the sender receives it too: retained topics (R9.1), and an activator's beacon (R9.6)."""
    return row.retained or (row.sender == ACTIVATOR and row.topic == OWN_BEACON)


def access_list(place: Place, members: Iterable[Certificate]) -> str:
    """The access list's text, for the certificates of the broker's members."""
    lines = ["# Made by `mqttxt broker`: make it again instead of changing it.", ""]
    for node, given in entries_of_all(place, members):
        lines += [f"user {node}", *(str(entry) for entry in given), ""]
    return "\n".join(lines)


def entries_of_all(place: Place, members: Iterable[Certificate]) -> Iterator[tuple[NodeName, list[Entry]]]:
    """Each member that has any entry at the broker, by name.

    While two certificates of a name are valid, the rights of the newer one count.
    """
    rights = {each.node: each.rights for each in sorted(members, key=lambda each: each.not_before_s)}
    fogs = [node for node in rights if node.kind is Kind.FOG]
    for node in sorted(rights, key=str):
        if given := entries(place, node, rights[node], fogs):
            yield node, given


def _filters(row: TopicRow, node: NodeName, rights: Rights, fogs: Iterable[NodeName]) -> Iterator[str]:
    """The filters for a row of the table and a node: a level that names a node is the node itself, or any."""
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
