"""Every topic of MQTT-XT as a table: sender, receiver, QoS, payload, and whether the message is retained.

`topics` builds and parses topics; this module has their use. docs/protocol.md (section 2) is generated from it.
X is a fog's number, Y a drone's, S a sensor's, Z a state's name, C a command's, G a station's, K a sensor value's kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .bulk import BulkAnswer, BulkAsk
from .bundles import DroneBundle, FogBundle
from .control import DroneLease, DroneRecord, Grant, Registration
from .messages import BeaconMessage, CommandMessage, FogPresence, FogResultMessage, Presence, ResultMessage
from .rankings import PsmiMessage, QodsMessage, SelectMessage
from .readings import ReadingAck, ReadingMessage
from .topics import REVOKED

STATION, STATIONS = "station", "stations"
ACTIVATOR, ACTIVATORS = "activator", "activators"
UAV = "UAV client"
SENSOR, SENSORS = "sensor", "sensors"
CLOUD_NODES, FOG_NODES = "stations, activators", "activator, UAV clients"
REVOCATION_LIST = "revocation list"


@dataclass(frozen=True)
class TopicRow:
    """One topic. `qos` is the default; `choice` marks what the thesis leaves open or does not have.

    `payload` is the message's class, or in words what it is where the class follows from the topic's last level.
    """

    topic: str
    sender: str
    receiver: str
    qos: int
    retained: bool
    payload: type[Any] | str
    what: str
    choice: bool = False


CLOUD_SIDE = (
    # Topic, sender, receiver, QoS, whether it is retained, payload; then what it is for.
    TopicRow("gs/G/reachable", STATION, ACTIVATORS, 1, True, Presence,
             "a station's birth and will; one will serves all its fogs", choice=True),
    TopicRow("fogX/init_connect", STATION, ACTIVATOR, 1, False, Registration,
             "registration: take, renew or end a lease"),
    TopicRow("fogX/reachable", ACTIVATOR, STATIONS, 1, True, FogPresence,
             "the activator's birth and will, its broker's address and its drones", choice=True),
    TopicRow("fogX/clock", ACTIVATOR, STATIONS, 0, False, BeaconMessage,
             "beacon", choice=True),
    TopicRow("fogX/droneY/reachable", ACTIVATOR, STATIONS, 1, True, DroneRecord,
             "whether a drone is reachable now; outside the gate", choice=True),
    TopicRow("fogX/droneY/birth", ACTIVATOR, STATIONS, 1, True, Presence,
             "a drone's birth as the drone signed it, with its certificate; only where messages are signed",
             choice=True),
    TopicRow("fogX/droneY/clock", ACTIVATOR, STATIONS, 0, False, BeaconMessage,
             "a drone's beacon as the drone signed it; only where messages are signed", choice=True),
    TopicRow("fogX/droneY/control", STATION, ACTIVATOR, 1, False, Grant,
             "how long a station grants itself control of a drone; only where messages are signed", choice=True),
    TopicRow("fogX/droneY/state/Z", ACTIVATOR, STATIONS, 0, False, "state Z",
             "a state, while the gate is open"),
    TopicRow("fogX/states", ACTIVATOR, STATIONS, 0, False, FogBundle,
             "the drones' changed states in one message, for stations that asked for bundles, while the gate is open",
             choice=True),
    TopicRow("fogX/QoDS", ACTIVATOR, STATIONS, 0, False, QodsMessage,
             "the ranking of the available drones, while the gate is open"),
    TopicRow("fogX/droneY/commands", STATION, ACTIVATOR, 1, False, CommandMessage,
             "a command for one drone"),
    TopicRow("fogX/commands", STATION, ACTIVATOR, 1, False, CommandMessage,
             "a broadcast to the fog's drones"),
    TopicRow("fogX/commands/C", STATION, ACTIVATOR, 1, False, SelectMessage,
             "a command whose drone the activator chooses (PSMI)"),
    TopicRow("fogX/PSMI", ACTIVATOR, STATIONS, 1, False, PsmiMessage,
             "the list that PSMI made for a command, with every figure", choice=True),
    TopicRow("fogX/commands_result/C", ACTIVATOR, STATIONS, 1, False, FogResultMessage,
             "a broadcast's roster, words of its drones together, or why the fog denied it", choice=True),
    TopicRow("fogX/droneY/commands_result/C", ACTIVATOR, STATIONS, 1, False, ResultMessage,
             "words about a command and a drone"),
    TopicRow("fogX/droneY/bulk", STATION, ACTIVATOR, 0, False, BulkAsk,
             "a piece of an object that is staged at the drone, or a question for one", choice=True),
    TopicRow("fogX/droneY/bulk_answer", ACTIVATOR, STATIONS, 0, False, BulkAnswer,
             "what the drone answers to that; outside the gate", choice=True),
    TopicRow("fogX/droneY/sensorS/K", ACTIVATOR, STATIONS, 1, False, ReadingMessage,
             "a reading that a drone carried; outside the gate"),
    TopicRow("fogX/droneY/sensor_ack", STATION, ACTIVATOR, 1, False, ReadingAck,
             "which readings a station has heard; only where messages are signed", choice=True),
    TopicRow(REVOKED, CLOUD_NODES, CLOUD_NODES, 1, True, REVOCATION_LIST,
             "the newest revocation list that any of them has, in DER; only where nodes have identities", choice=True),
)  # fmt: skip

FOG_SIDE = (
    TopicRow("droneY/reachable", UAV, ACTIVATOR, 1, True, Presence,
             "the drone's birth and will"),
    TopicRow("droneY/clock", UAV, ACTIVATOR, 0, False, BeaconMessage,
             "beacon", choice=True),
    TopicRow("droneY/init_connect", ACTIVATOR, UAV, 1, False, DroneLease,
             "the activator's lease: a nonce to echo, or that this client is refused"),
    TopicRow("droneY/stations", ACTIVATOR, UAV, 1, False, Presence,
             "a station's birth as the station signed it, with its certificate; only where messages are signed",
             choice=True),
    TopicRow("droneY/control", ACTIVATOR, UAV, 1, False, Grant,
             "a station's grant as the station signed it; only where messages are signed", choice=True),
    TopicRow("droneY/state/Z", UAV, ACTIVATOR, 0, False, "state Z",
             "a state, whether or not the gate is open"),
    TopicRow("droneY/states", UAV, ACTIVATOR, 0, False, DroneBundle,
             "states that are due together, from a UAV client that bundles", choice=True),
    TopicRow("droneY/commands", ACTIVATOR, UAV, 1, False, CommandMessage,
             "a command"),
    TopicRow("droneY/commands_result/C", UAV, ACTIVATOR, 1, False, ResultMessage,
             "words about a command"),
    TopicRow("droneY/bulk", ACTIVATOR, UAV, 0, False, BulkAsk,
             "a piece of an object that a station stages, or a question for one", choice=True),
    TopicRow("droneY/bulk_answer", UAV, ACTIVATOR, 0, False, BulkAnswer,
             "the answer to that", choice=True),
    TopicRow("droneY/sensorS/K", UAV, ACTIVATOR, 1, False, ReadingMessage,
             "a reading, repeated until it is acknowledged"),
    TopicRow("droneY/sensor_ack", ACTIVATOR, UAV, 1, False, ReadingAck,
             "which readings the activator has passed on; where messages are signed, as a station has signed it",
             choice=True),
    TopicRow(REVOKED, FOG_NODES, FOG_NODES, 1, True, REVOCATION_LIST,
             "the newest revocation list that any of them has, in DER; only where nodes have identities", choice=True),
)  # fmt: skip


SENSOR_SIDE = (
    TopicRow("sensorS/K", SENSOR, UAV, 1, False, ReadingMessage,
             "a reading, repeated until it is acknowledged if it can"),
    TopicRow("sensor_ack", UAV, SENSORS, 1, False, ReadingAck,
             "which readings the drone has stored", choice=True),
    TopicRow(REVOKED, UAV, SENSORS, 1, True, REVOCATION_LIST,
             "the newest revocation list that the drone has, in DER; only where nodes have identities", choice=True),
)  # fmt: skip


def topics_of(payload: type[Any]) -> list[str]:
    """The topics that carry messages of a class, first those of the cloud side."""
    return [row.topic for row in (*CLOUD_SIDE, *FOG_SIDE, *SENSOR_SIDE) if row.payload is payload]
