"""MQTT-SN in datagrams, read as the MQTT packets that it stands for: the air links of a flight with AIR=sn."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from mqttxt.core.mqtt.sn import codec
from mqttxt.core.mqtt.sn.packets import PREDEFINED, Message
from mqttxt.core.mqtt.sn.sender import Receiver
from mqttxt.core.mqtt.sn.together import AirMessage, Unpacker, pack
from mqttxt.core.mqtt.sn.topic_ids import TOGETHER, TopicIds

from .mqtt import Direction, Packet

IDS = TopicIds()
_UNREADABLE = "reserved"


@dataclass(frozen=True)
class Datagram:
    """The datagram in a frame: the frame's row, when it had left the link (None if never), and its content."""

    row: int
    left_ns: int | None
    body: bytes


@dataclass
class _Flow:
    """The state of reading the datagrams from one port to another, in the order of time."""

    receiver: Receiver = field(default_factory=Receiver)
    unpacker: Unpacker = field(default_factory=lambda: Unpacker(IDS))
    last: tuple[int, range] = (0, range(0))
    """The message id of the last PUBLISH at QoS 1, and the indexes of its messages in `Direction.packets`."""


def read_datagrams(flows: Iterable[list[Datagram]]) -> Direction:
    """Read the messages of all flows. A repeated PUBLISH is a copy: the message arrives with the first copy that does.

    A frame counts for the messages that end in it. A datagram in which none ends, as all but the last piece of a long
    message, counts as a `publish` without a topic.
    """
    found = Direction()
    for datagrams in flows:
        flow = _Flow()
        for datagram in datagrams:
            _read(datagram, flow, found)
    return found


def _read(datagram: Datagram, flow: _Flow, found: Direction) -> None:
    try:
        packet = codec.decode(datagram.body)
    except ValueError:
        _note(found, datagram, _UNREADABLE)
        return
    if not isinstance(packet, Message):
        _note(found, datagram, type(packet).__name__.lower())
        return
    if packet.qos and not flow.receiver.is_new(packet.msg_id):
        _again(datagram, packet, flow, found)
        return
    first = len(found.packets)
    told = _told(packet, flow)
    found.payload_bytes[datagram.row] = sum(len(each.payload) for each in told)
    beside = len(datagram.body) - sum(len(pack(each, IDS)) for each in told[1:])
    for each in told:
        size = beside if each is told[0] else len(pack(each, IDS))
        found.packets.append(Packet(datagram.row, datagram.left_ns, "publish", each.topic, each.payload, size, 1))
    if not told:
        _note(found, datagram, "publish")
    if packet.qos:
        flow.last = packet.msg_id, range(first, len(found.packets))


def _told(packet: Message, flow: _Flow) -> list[AirMessage]:
    """The messages that end in a PUBLISH; none if its topic is not predefined."""
    if packet.topic_id == TOGETHER and packet.id_type == PREDEFINED:
        try:
            return flow.unpacker.take(packet.payload)
        except ValueError:
            return []
    topic = IDS.topic_of(packet.topic_id) if packet.id_type == PREDEFINED else None
    return [AirMessage(topic, packet.payload, packet.qos, packet.retain)] if topic is not None else []


def _again(datagram: Datagram, packet: Message, flow: _Flow, found: Direction) -> None:
    """Note a repetition: its messages leave the link with it if no earlier copy did."""
    msg_id, places = flow.last
    if msg_id != packet.msg_id:  # the one after it was sent, so this one had been answered
        found.repeated[datagram.row] = True
        _note(found, datagram, "publish")
        return
    found.repeated[datagram.row] = any(found.packets[place].left_ns is not None for place in places)
    for place in places:
        before = found.packets[place]
        left_ns = datagram.left_ns if before.left_ns is None else before.left_ns
        found.packets[place] = replace(before, left_ns=left_ns, copies=before.copies + 1)
    if places:
        found.carried[datagram.row] = found.packets[places[0]]
        found.payload_bytes[datagram.row] = sum(len(found.packets[place].payload or b"") for place in places)


def _note(found: Direction, datagram: Datagram, kind: str) -> None:
    found.packets.append(Packet(datagram.row, datagram.left_ns, kind, None, None, len(datagram.body), 1))
