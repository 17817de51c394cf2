"""The least bytes of a broadcast and its words on each link, beside MAVLink's: `python -m tests.bench word_budget`.

Nothing is flown: the messages of arm, takeoff and land to a fog of three drones, each as its shortest frame. Each drone
publishes one word, and a fog's words leave in one message with the roster. TCP acknowledges each frame by one of its
own, as an answer arrives later than an acknowledgement may wait; at QoS 1 that is the PUBACK's, which has one itself.
"""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.effects import Publish
from mqttxt.core.mqtt import packets as mqtt
from mqttxt.core.mqtt.sn import codec as sn_codec
from mqttxt.core.mqtt.sn import packets as sn
from mqttxt.core.mqtt.sn.topic_ids import TopicIds
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Command, Land, Takeoff
from mqttxt.protocol.messages import FogResultMessage, ResultMessage, RosterEntry, Word, WordTogether
from mqttxt.protocol.topics import CloudSide, FogSide
from mqttxt.protocol.values import Encoding
from tests.bench.vital import STAMP, command_payload, mavlink_commands, packed

DRONES = (1, 2, 3)
FLOWN: tuple[Command, ...] = (Arm(), Takeoff(10), Land())
UDP, TCP, LEAN_TCP = 14 + 20 + 8, 14 + 20 + 32, 14 + 20 + 20
"""Headers of Ethernet, IPv4 and UDP; and TCP, with time stamps and without."""
_PUBACK, _PACKET_ID = 4, 2
_SESSION, _STATION = 0x9ABCDEF0, 0x12345678


@dataclass(frozen=True)
class Way:
    """How messages travel: headers over TCP, the QoS of commands and words, and whether the air leg has MQTT-SN."""

    name: str
    headers: int
    qos: int
    by_datagrams: bool = False

    def message(self, topic: str, payload: bytes, expiry_s: int | None = None) -> int:
        """Bytes of a message over TCP with all of its acknowledgements; at QoS 0 its topic has an alias."""
        alias = 1 if self.qos == 0 else None
        publish = Publish("x", topic, payload, 0, expiry_s=expiry_s)
        size = self.headers + len(mqtt.publish(publish, "" if alias else topic, alias))
        return size + self.headers + (_PACKET_ID + _PUBACK + self.headers if self.qos else 0)

    def on_air(self, topic: str, payload: bytes, expiry_s: int | None = None) -> int:
        """The same between drone and fog."""
        if not self.by_datagrams:
            return self.message(topic, payload, expiry_s)
        topic_id = TopicIds().id_of(topic) or 0
        sizes = [
            sn_codec.encode(sn.Message(topic_id, payload, qos=1, msg_id=1)),
            sn_codec.encode(sn.Puback(topic_id, 1)),
        ]
        return sum(UDP + len(datagram) for datagram in sizes)


WAYS = (
    Way("QoS 1", TCP, 1),
    Way("QoS 0", TCP, 0),
    Way("QoS 1, air by MQTT-SN", TCP, 1, by_datagrams=True),
    Way("QoS 0, air by MQTT-SN", TCP, 0, by_datagrams=True),
    Way("QoS 0, air by MQTT-SN, no time stamps", LEAN_TCP, 0, by_datagrams=True),
)


def measure() -> list[str]:
    """A line for each way: bytes per broadcast on a link between station and fog, on all air links, and the ratio."""
    by_mavlink = len(DRONES) * sum(_mavlink(command.name) for command in FLOWN)
    lines = [f"MAVLink: {by_mavlink / len(FLOWN):.0f} B on each of three links"]
    for way in WAYS:
        far = sum(_far(way, command) for command in FLOWN)
        air = sum(_air(way, command) for command in FLOWN)
        times = (2 * far + air) / (3 * by_mavlink)
        shown = f"{far / len(FLOWN):.0f} B on wan and on backhaul, {air / len(FLOWN):.0f} B on air"
        lines.append(f"{way.name}: {shown}; {times:.2f} times MAVLink's")
    return lines


def _mavlink(name: str) -> int:
    acknowledged = packed(mavlink.MAVLink_command_ack_message(400, 0, 0, 0, 245, 190))
    return sum(UDP + len(message) for message in (mavlink_commands()[name], acknowledged))


def _far(way: Way, command: Command) -> int:
    """The command to the fog, and the words of its drones with the roster, on one link."""
    cloud = CloudSide(1)
    words = tuple(WordTogether(drone=drone, session=_SESSION, stamp=STAMP, word=Word.COMPLETED) for drone in DRONES)
    said = FogResultMessage(
        gs_session=_STATION,
        seq=7,
        session=_SESSION,
        stamp=STAMP,
        roster=tuple(RosterEntry(drone=drone, session=_SESSION) for drone in DRONES),
        words=words,
    )
    down = way.message(cloud.broadcast, command_payload(command, Encoding.CBOR), expiry_s=5)
    return down + way.message(cloud.fog_result(command.name), encode(said))


def _air(way: Way, command: Command) -> int:
    """The command to each drone and its word, on all of their links."""
    fog = FogSide()
    word = ResultMessage(gs_session=_STATION, seq=7, session=_SESSION, stamp=STAMP, word=Word.COMPLETED)
    down = way.on_air(fog.commands(1), command_payload(command, Encoding.CBOR), expiry_s=5)
    return len(DRONES) * (down + way.on_air(fog.commands_result(1, command.name), encode(word)))
