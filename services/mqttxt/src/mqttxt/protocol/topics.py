"""Builds and parses every topic of MQTT-XT; no other module does (docs/protocol.md, section 2).

Numbers are ASCII `[1-9][0-9]*` of at most nine digits, names 1 to 64 of `[A-Za-z0-9_.-]`. A root may have a prefix
(`acme/`); on a broker that cloud and fog share, the fog side has the root `<prefix>fogX/local/`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

from ..errors import PayloadError
from .names import (
    MAX_DRONE,
    MAX_SENSOR,
    NAME,
    NUMBER,
    STATIONS,
    check_kind,
    check_number,
    check_prefix,
    check_station_name,
)

_NAME = re.compile(NAME)


@dataclass(frozen=True)
class DroneTopic:
    """A parsed fog-side topic, or the rest of a cloud-side one after `fogX/`: drone, kind, name.

    kind is `reachable`, `clock`, `init_connect`, `state`, `states`, `commands`, `commands_result`, `sensor`,
    `sensor_ack`, `birth`, `stations`, `control`, `bulk` or `bulk_answer`; name is the state's, the
    command's or the reading's kind, empty for the others; sensor is the number in `sensorS`, 0 for the others.
    """

    drone: int
    kind: str
    name: str = ""
    sensor: int = 0


@dataclass(frozen=True)
class FogTopic:
    """A cloud-side topic of a fog itself: kind, and the command's name for `commands_result` and `select`.

    kind is `reachable`, `clock`, `init_connect`, `states`, `QoDS`, `PSMI`, `commands` (broadcast),
    `commands_result` or `select` (`fogX/commands/C`, where PSMI chooses the drone).
    """

    kind: str
    name: str = ""


@dataclass(frozen=True)
class StationTopic:
    """`gs/G/reachable`."""

    name: str
    kind: ClassVar[str] = "reachable"


Topic = DroneTopic | FogTopic | StationTopic

_FOG_KINDS = frozenset({"reachable", "clock", "init_connect", "commands", "states", "QoDS", "PSMI"})
_DRONE_KINDS = frozenset(
    {
        "reachable", "clock", "init_connect", "commands", "states", "sensor_ack", "birth", "stations", "control",
        "bulk", "bulk_answer",
    }
)  # fmt: skip
_NAMED_KINDS = frozenset({"state", "commands_result"})
MAVLINK_STATE = "mavlink/"
"""The prefix of the names of states that are unchanged MAVLink messages."""
SELECTABLE = ("goto",)
"""The commands for which PSMI chooses a drone."""
REVOKED = "fleet/revoked"
"""Below either side's root: the fleet's revocation list, to which every node with an identity subscribes."""


def _number(level: str, what: str, most: int) -> int | None:
    if not level.startswith(what):
        return None
    digits = level.removeprefix(what)
    if not NUMBER.fullmatch(digits) or int(digits) > most:
        raise PayloadError(f"topic level {level!r}: expected {what} and a number from 1 to {most}", "topic")
    return int(digits)


class FogSide:
    """The topics between an activator and its UAV clients, below `root` (empty on an embedded broker)."""

    def __init__(self, root: str = "") -> None:
        self.root = root

    revoked = property(lambda self: f"{self.root}{REVOKED}")

    def reachable(self, drone: int) -> str:
        return f"{self.root}drone{drone}/reachable"

    def clock(self, drone: int) -> str:
        return f"{self.root}drone{drone}/clock"

    def init_connect(self, drone: int) -> str:
        return f"{self.root}drone{drone}/init_connect"

    def state(self, drone: int, name: str) -> str:
        return f"{self.root}drone{drone}/state/{name}"

    def states(self, drone: int) -> str:
        return f"{self.root}drone{drone}/states"

    def sensor(self, drone: int, sensor: int, kind: str) -> str:
        return f"{self.root}drone{drone}/sensor{sensor}/{kind}"

    def sensor_ack(self, drone: int) -> str:
        return f"{self.root}drone{drone}/sensor_ack"

    def stations(self, drone: int) -> str:
        return f"{self.root}drone{drone}/stations"

    def control(self, drone: int) -> str:
        return f"{self.root}drone{drone}/control"

    def bulk(self, drone: int) -> str:
        return f"{self.root}drone{drone}/bulk"

    def bulk_answer(self, drone: int) -> str:
        return f"{self.root}drone{drone}/bulk_answer"

    def commands(self, drone: int) -> str:
        return f"{self.root}drone{drone}/commands"

    def commands_result(self, drone: int, command: str) -> str:
        return f"{self.root}drone{drone}/commands_result/{command}"

    def activator_filters(self) -> tuple[str, ...]:
        """An activator's subscriptions on the fog side; no two filters match one topic.

        `+/+/+` matches states, results and sensors: a filter cannot express `sensor` with any number.
        """
        kinds = ("reachable", "clock", "states", "bulk_answer", "+/+", "state/mavlink/+")
        return tuple(f"{self.root}+/{rest}" for rest in kinds)

    def parse(self, topic: str) -> DroneTopic:
        """Parse a topic below this root. Raises PayloadError for any other."""
        if not topic.startswith(self.root):
            raise PayloadError(f"topic {topic!r}: expected the root {self.root!r}", "topic")
        return _drone_topic(topic, len(self.root))


class SensorSide:
    """The topics between sensors and the UAV client that carries their readings, on the drone's own broker."""

    ack = "sensor_ack"
    filter = "+/+"

    def sensor(self, sensor: int, kind: str) -> str:
        return f"sensor{sensor}/{check_kind(kind)}"

    def parse(self, topic: str) -> tuple[int, str]:
        """The sensor's number and the kind in a `sensorS/K` topic. Raises PayloadError for any other topic."""
        first, _, kind = topic.partition("/")
        sensor = _number(first, "sensor", MAX_SENSOR)
        if sensor is None:
            raise PayloadError(f"topic {topic[:100]!r}: not a sensor's", "topic")
        return sensor, check_kind(kind)


class CloudSide:
    """The topics of one fog between its activator and the ground stations."""

    def __init__(self, fog: int, prefix: str = "") -> None:
        self.fog = check_number("fog", fog)
        self.prefix = check_prefix(prefix)
        self.root = f"{self.prefix}fog{fog}/"

    reachable = property(lambda self: f"{self.root}reachable")
    clock = property(lambda self: f"{self.root}clock")
    init_connect = property(lambda self: f"{self.root}init_connect")
    broadcast = property(lambda self: f"{self.root}commands")
    states = property(lambda self: f"{self.root}states")
    qods = property(lambda self: f"{self.root}QoDS")
    psmi = property(lambda self: f"{self.root}PSMI")
    revoked = property(lambda self: f"{self.prefix}{REVOKED}")

    def select(self, command: str) -> str:
        return f"{self.root}commands/{command}"

    def fog_result(self, command: str) -> str:
        return f"{self.root}commands_result/{command}"

    def drone_reachable(self, drone: int) -> str:
        return f"{self.root}drone{drone}/reachable"

    def drone_birth(self, drone: int) -> str:
        return f"{self.root}drone{drone}/birth"

    def drone_control(self, drone: int) -> str:
        return f"{self.root}drone{drone}/control"

    def drone_bulk(self, drone: int) -> str:
        return f"{self.root}drone{drone}/bulk"

    def drone_bulk_answer(self, drone: int) -> str:
        return f"{self.root}drone{drone}/bulk_answer"

    def drone_clock(self, drone: int) -> str:
        return f"{self.root}drone{drone}/clock"

    def signed_drone_clock(self, drone: int) -> str:
        """The topic that a drone signs for its beacons on either side, by which it names its fog."""
        return self.drone_clock(drone).removeprefix(self.prefix)

    def drone_state(self, drone: int, name: str) -> str:
        return f"{self.root}drone{drone}/state/{name}"

    def drone_sensor(self, drone: int, sensor: int, kind: str) -> str:
        return f"{self.root}drone{drone}/sensor{sensor}/{kind}"

    def drone_sensor_ack(self, drone: int) -> str:
        return f"{self.root}drone{drone}/sensor_ack"

    def drone_commands(self, drone: int) -> str:
        return f"{self.root}drone{drone}/commands"

    def drone_result(self, drone: int, command: str) -> str:
        return f"{self.root}drone{drone}/commands_result/{command}"

    def local_root(self) -> str:
        """The fog side's root on a broker that it shares with the cloud side."""
        return f"{self.root}local/"

    def activator_command_filters(self) -> tuple[str, ...]:
        select = tuple(self.select(command) for command in SELECTABLE)
        return (f"{self.root}commands", f"{self.root}+/commands", *select)

    def activator_filters(self, signed: bool = False) -> tuple[str, ...]:
        """An activator's subscriptions except commands: registrations, stations, its own records, objects.

        `signed`: messages are signed, so grants and acknowledgements of stations too.
        """
        return (
            f"{self.root}init_connect",
            f"{self.root}reachable",
            f"{self.root}+/reachable",
            f"{self.root}+/bulk",
            *((f"{self.root}+/control", f"{self.root}+/sensor_ack") if signed else ()),
            f"{self.prefix}{STATIONS}/+/reachable",
        )

    def station_filters(self, signed: bool = False) -> tuple[str, ...]:
        """A ground station's subscriptions; no two filters match one topic. `signed`: messages are signed."""
        own = ("reachable", "clock", "states", "QoDS", "PSMI", "commands_result/#")
        drones = (
            "+/reachable",
            "+/bulk_answer",
            *(("+/birth", "+/clock") if signed else ()),
            "+/+/+",
            "+/state/mavlink/+",
        )
        return tuple(f"{self.root}{rest}" for rest in (*own, *drones))

    def parse(self, topic: str) -> Topic:
        """Parse a topic of this fog or of a station. Raises PayloadError for any other."""
        if not topic.startswith(self.root):
            station = station_of(topic, self.prefix)
            if station is None:
                raise PayloadError(f"topic {topic!r}: expected the root {self.root!r}", "topic")
            return StationTopic(station)
        levels = topic.removeprefix(self.root).split("/")
        if len(levels) == 1 and levels[0] in _FOG_KINDS:
            return FogTopic(levels[0])
        if len(levels) == 2 and levels[0] == "commands_result" and _NAME.fullmatch(levels[1]):
            return FogTopic(levels[0], levels[1])
        if len(levels) == 2 and levels[0] == "commands" and levels[1] in SELECTABLE:
            return FogTopic("select", levels[1])
        return _drone_topic(topic, len(self.root))


@lru_cache(maxsize=8192)
def _drone_topic(topic: str, root: int) -> DroneTopic:
    """Parse a topic by its levels behind a root of that length; cached: an activator receives the same ones again."""
    levels = topic[root:].split("/")
    drone = _number(levels[0], "drone", MAX_DRONE)
    if drone is not None and len(levels) == 2 and levels[1] in _DRONE_KINDS:
        return DroneTopic(drone, levels[1])
    if drone is not None and len(levels) == 3 and _NAME.fullmatch(levels[2]):
        if levels[1] in _NAMED_KINDS:
            return DroneTopic(drone, levels[1], levels[2])
        sensor = _number(levels[1], "sensor", MAX_SENSOR)
        if sensor is not None:
            return DroneTopic(drone, "sensor", check_kind(levels[2]), sensor)
    if drone is not None and len(levels) == 4 and levels[1:3] == ["state", "mavlink"] and _NAME.fullmatch(levels[3]):
        return DroneTopic(drone, "state", MAVLINK_STATE + levels[3])
    raise PayloadError(f"topic {topic!r}: not a topic of MQTT-XT", "topic")


def station_reachable(name: str, prefix: str = "") -> str:
    """`gs/G/reachable`."""
    return f"{check_prefix(prefix)}{STATIONS}/{check_station_name(name)}/reachable"


def station_of(topic: str, prefix: str = "") -> str | None:
    """The station's name of a `gs/G/reachable` topic, None for any other topic."""
    levels = topic.removeprefix(prefix).split("/") if topic.startswith(prefix) else []
    if len(levels) == 3 and levels[0] == STATIONS and levels[2] == "reachable" and _NAME.fullmatch(levels[1]):
        return levels[1]
    return None
