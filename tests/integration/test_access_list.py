"""Every role, topic and direction at a real Mosquitto with the generated configuration: what is delivered is the table.

Mosquitto grants every SUBSCRIBE and may acknowledge what it drops, so only deliveries count.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import pytest

from mqttxt.protocol.bulk import BulkAsk
from mqttxt.protocol.control import Grant
from mqttxt.protocol.messages import CommandMessage
from mqttxt.protocol.rankings import SelectMessage
from mqttxt.protocol.topic_table import (
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
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from tests.rigs.processes import wait_until
from tests.rigs.secure import WITNESS, Node, SecureBroker

pytestmark = [pytest.mark.integration, pytest.mark.apart]

STATIONS_RIGHTS = {
    "gs-ops": Rights(None, take_over=True, observe=True),
    "gs-one": Rights(frozenset({1})),
    "gs-view": Rights(observe=True),
    "gs-none": Rights(),
}
NODES = ("fog1", "fog2", "drone1", "drone2", "sensor1", "sensor2", *STATIONS_RIGHTS)
BROKERS = {"broker-cloud": CLOUD_SIDE, "broker-fog1": FOG_SIDE, "broker-drone1": SENSOR_SIDE}
ELSEWHERE = ("fog3/clock", "drone3/secret", "drone1", "$SYS/broker/uptime", "gs/ops", "fog1/commands/x/y/z", "x")
"""Topics that are not in the table, or of nodes that do not exist: nobody may publish them."""


@dataclass(frozen=True)
class Topic:
    """A topic of the table with its numbers and names filled in; without a row it is nobody's."""

    text: str
    row: TopicRow | None = None
    fog: int = 0
    drone: int = 0
    sensor: int = 0
    station: str = ""
    local: int = 0
    """The fog on whose side of a shared broker it is, 0 for the broker's own."""


def topics(rows: tuple[TopicRow, ...], prefix: str, local: int = 0) -> Iterator[Topic]:
    for row in rows:
        levels = row.topic.split("/")
        for fog in (1, 2) if "fogX" in levels else (0,):
            for drone in (1, 2) if "droneY" in levels else (0,):
                for sensor in (1, 2) if "sensorS" in levels else (0,):
                    for station in ("ops", "one", "none") if "G" in levels else ("",):
                        for state in ("location", "mavlink/ATTITUDE") if "Z" in levels else ("",):
                            filled = {
                                "fogX": f"fog{fog}",
                                "droneY": f"drone{drone}",
                                "sensorS": f"sensor{sensor}",
                                "G": station,
                                "Z": state,
                                "C": "goto",
                                "K": "temperature",
                            }
                            text = prefix + "/".join(filled.get(level, level) for level in levels)
                            yield Topic(text, row, fog, drone, sensor, station, local)


def every_topic(broker: str, prefix: str, fogs: frozenset[int]) -> Iterator[Topic]:
    """Those of the table at a broker that some fogs share, and others."""
    yield from topics(BROKERS[broker], prefix)
    for fog in fogs:
        yield from topics(FOG_SIDE, f"{prefix}fog{fog}/local/", fog)
    for text in (*ELSEWHERE, f"{prefix}fog2/local/drone1/commands_result/arm"):
        yield Topic(text)


def expected(broker: str, node: str, topic: Topic) -> tuple[bool, bool]:
    """Whether a node may publish and may hear a topic, as the table and the specification's section 11 say it."""
    row = topic.row
    if row is None:
        return False, False
    owns = (row.sender, row.receiver)
    if topic.local and not node.startswith(("drone", f"fog{topic.local}")):
        return False, False
    if node.startswith("fog"):
        if broker == "broker-fog1" and node != "fog1":
            return False, False
        mine = topic.fog in (0, int(node[3:]))
        publish, hear = _both(row, [mine and each in (ACTIVATOR, ACTIVATORS, CLOUD_NODES, FOG_NODES) for each in owns])
        as_readings = topic.local != 0 and row.topic.count("/") == 1  # to itself: the filter of readings matches
        return publish or as_readings, hear
    if node.startswith("drone"):
        if broker == "broker-drone1":
            return _both(row, [node == "drone1" and each == UAV for each in owns])
        return _both(row, [topic.drone in (0, int(node[5:])) and each in (UAV, FOG_NODES) for each in owns])
    if node.startswith("sensor"):
        return row.sender == SENSOR and topic.sensor == int(node[6:]), row.receiver == SENSORS
    rights = STATIONS_RIGHTS[node]
    if rights == Rights() or (topic.station and f"gs-{topic.station}" != node):
        return False, False
    publish, hear = _both(row, [each in (STATION, STATIONS, CLOUD_NODES) for each in owns])
    if row.payload in (CommandMessage, Grant, SelectMessage, BulkAsk):
        publish &= rights.may_command(topic.drone) if topic.drone else rights.command != frozenset()
    return publish, hear


def _both(row: TopicRow, owns: list[bool]) -> tuple[bool, bool]:
    """Who owns a retained topic hears it too (R9.1), and an activator its own beacon (R9.6)."""
    publish, hear = owns
    return publish, hear or (publish and (row.retained or row.topic == "fogX/clock"))


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    authority = Authority.create(tmp_path_factory.mktemp("fleet") / "acme", "acme")
    for name in (*BROKERS, *NODES, WITNESS):
        authority.issue(name, STATIONS_RIGHTS.get(name))
    return authority


@pytest.mark.parametrize(
    ("name", "prefix", "fogs"),
    [
        ("broker-cloud", "", frozenset[int]()),
        ("broker-cloud", "acme/", frozenset[int]()),
        ("broker-cloud", "acme/", frozenset({1})),
        ("broker-fog1", "", frozenset[int]()),
        ("broker-drone1", "", frozenset[int]()),
    ],
)
def test_delivered_is_what_the_table_says(fleet: Authority, name: str, prefix: str, fogs: frozenset[int]) -> None:
    broker = SecureBroker(fleet, name, prefix, fogs=fogs)
    broker.let_witness()
    every = list(every_topic(name, prefix, fogs))
    with ExitStack() as stack:
        stack.callback(broker.kill)
        broker.start()
        witness, *nodes = (_connect(stack, fleet, each, broker) for each in (WITNESS, *NODES))
        witness.publish([topic.text for topic in every], b"hear")
        for node in nodes:
            node.catch_up()
            node.publish([topic.text for topic in every], node.name.encode())
        witness.catch_up()
        found, wanted = {}, {}
        for node in nodes:
            for topic in every:
                key = (node.name, topic.text)
                published = (topic.text, node.name.encode()) in witness.heard
                heard = (topic.text, b"hear") in node.heard
                found[key] = (published, heard and topic.row is not None)
                wanted[key] = expected(name, node.name, topic)
        assert {key: found[key] for key in found if found[key] != wanted[key]} == {}
        assert any(publish for publish, _ in wanted.values())
        assert any(hear for _, hear in wanted.values())
        assert not any(topic.startswith("$SYS") for node in nodes for topic, _ in node.heard)


def _connect(stack: ExitStack, fleet: Authority, name: str, broker: SecureBroker) -> Node:
    node = Node(Identity.load(fleet.folder / name), broker)
    stack.callback(node.close)
    node.subscribe("$SYS/#")
    return node


def test_a_revoked_station_is_silenced_at_a_reload_and_does_not_come_back(fleet: Authority) -> None:
    broker = SecureBroker(fleet, "broker-cloud")
    with ExitStack() as stack:
        stack.callback(broker.kill)
        broker.start()
        ops, fog = (_connect(stack, fleet, each, broker) for each in ("gs-ops", "fog1"))
        ops.publish(["fog1/drone1/commands"], b"before")
        fog.catch_up()
        assert ("fog1/drone1/commands", b"before") in fog.heard
        identity = Identity.load(fleet.folder / "gs-ops")
        fleet.revoke("gs-ops")
        broker.files.write_access(broker.out)
        broker.reload()
        wait_until(lambda: "Reloading config" in broker.said(), "the broker has reloaded")
        fog.catch_up()
        ops.publish(["fog1/drone1/commands"], b"after")
        fog.catch_up()
        assert ("fog1/drone1/commands", b"after") not in fog.heard
        with pytest.raises(ConnectionError):
            Node(identity, broker)
