"""Captures to frames: each frame of a pcap with its layers' bytes and the MQTT messages that begin in it."""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from scapy.error import Scapy_Exception
from scapy.utils import RawPcapReader

from .errors import ResultsError

ETHERNET = 14
MQTT_PORT = 1883
MQTT_TYPES = (
    *("reserved", "connect", "connack", "publish", "puback", "pubrec", "pubrel", "pubcomp"),
    *("subscribe", "suback", "unsubscribe", "unsuback", "pingreq", "pingresp", "disconnect", "auth"),
)
_TCP, _UDP = 6, 17
_SYN = 0x02
_TOPIC_ALIAS = 0x23
_FIXED_PROPERTIES = {0x01: 1, 0x02: 4, _TOPIC_ALIAS: 2}
"""Bytes of a PUBLISH's properties (MQTT 5.0, 3.3.2.3); the others are strings, or a variable byte integer."""
_TEXTS = {0x03: 1, 0x08: 1, 0x09: 1, 0x26: 2}
_ETHER_TYPES = {0x0806: "arp", 0x86DD: "ipv6"}
_IP_PROTOCOLS = {1: "icmp", 2: "igmp"}
_PCAP_HEADER, _PACKET_HEADER = 24, 16

logging.getLogger("scapy.runtime").setLevel(logging.ERROR)  # a capture that was cut off is said in the report


@dataclass(frozen=True)
class Publish:
    """A PUBLISH: topic, payload, and the bytes that are MQTT's own (fixed and variable header).

    The topic is the one that an alias stands for (MQTT 5.0, 3.3.2.3.4); empty where the capture does not tell it.
    """

    topic: str
    payload: bytes
    header_bytes: int


@dataclass(frozen=True)
class Frame:
    """One Ethernet frame: `t_ns` since the epoch, bytes without the FCS, split by layer.

    `mqtt` are the types of the MQTT packets that begin in it, `publishes` those of them that are PUBLISHes.
    `source` and `destination` are None for what is not IPv4.
    """

    t_ns: int
    size: int
    source: str | None
    destination: str | None
    protocol: str
    layers: dict[str, int]
    mqtt: tuple[str, ...] = ()
    publishes: tuple[Publish, ...] = ()
    key: bytes = b""


Aliases = dict[int, str]
"""The topics that one direction of a connection has given numbers to."""


@dataclass
class CaptureNotes:
    """What there is to say about a capture file."""

    truncated: bool = False


def read_frames(path: Path, notes: CaptureNotes | None = None) -> Iterator[Frame]:
    """The frames of a pcap in their order, up to a cut if there is one (`notes` says so).

    Raises ResultsError when the file is no pcap.
    """
    try:
        if path.stat().st_size == 0:  # as a full disk leaves it
            if notes is not None:
                notes.truncated = True
            return
        reader = RawPcapReader(str(path))
    except (OSError, Scapy_Exception) as error:
        raise ResultsError(f"{path}: not a capture: {error}") from error
    nano = bool(getattr(reader, "nano", False))
    whole = _PCAP_HEADER
    flows: dict[bytes, Aliases] = {}
    with reader:
        for data, meta in reader:
            if len(data) < meta.caplen:
                break
            whole += _PACKET_HEADER + len(data)
            t_ns = meta.sec * 1_000_000_000 + meta.usec * (1 if nano else 1000)
            yield dissect(t_ns, data, meta.wirelen, flows)
    if notes is not None:
        notes.truncated = whole != path.stat().st_size


def dissect(t_ns: int, data: bytes, size: int, flows: dict[bytes, Aliases]) -> Frame:
    """One frame's layers; whatever is not IPv4 over Ethernet is counted whole.

    `flows` keeps what earlier frames said of each direction of each connection.
    """
    if len(data) < ETHERNET + 20 or data[12:14] != b"\x08\x00":
        name = _ETHER_TYPES.get(int.from_bytes(data[12:14], "big"), "other")
        return Frame(t_ns, size, None, None, name, {"ethernet": size})
    ip = ETHERNET
    header = (data[ip] & 0x0F) * 4
    total = struct.unpack_from("!H", data, ip + 2)[0]
    source, destination = _address(data, ip + 12), _address(data, ip + 16)
    layers = {"ethernet": ETHERNET + max(0, size - ETHERNET - total), "ip": header}
    protocol, start = data[ip + 9], ip + header
    end = ip + total
    key = data[ip + 4 : ip + 6] + data[start : start + 8] + struct.pack("!H", total)
    if protocol == _UDP:
        layers |= {"udp": 8, "payload": max(0, end - start - 8)}
        return Frame(t_ns, size, source, destination, "udp", layers, key=key)
    if protocol != _TCP or len(data) < start + 20:
        layers["payload"] = max(0, end - start)
        name = _IP_PROTOCOLS.get(protocol, "other")
        return Frame(t_ns, size, source, destination, name, layers, key=key)
    offset = (data[start + 12] >> 4) * 4
    layers["tcp"] = offset
    body = data[start + offset : end]
    ports = struct.unpack_from("!HH", data, start)
    if MQTT_PORT not in ports:
        layers["payload"] = len(body)
        return Frame(t_ns, size, source, destination, "tcp", layers, key=key)
    flow = data[ip + 12 : ip + 20] + data[start : start + 4]
    if data[start + 13] & _SYN:
        flows.pop(flow, None)
    kinds, publishes = mqtt_packets(body, flows.setdefault(flow, {}))
    carried = sum(len(publish.payload) for publish in publishes)
    layers |= {"mqtt": len(body) - carried, "payload": carried}
    return Frame(t_ns, size, source, destination, "mqtt", layers, kinds, publishes, key)


def mqtt_packets(body: bytes, aliases: Aliases) -> tuple[tuple[str, ...], tuple[Publish, ...]]:
    """The MQTT packets that begin in a segment, while they follow each other from its first byte.

    `aliases` are those of the direction that the segment goes, and learn from it.
    """
    kinds: list[str] = []
    publishes: list[Publish] = []
    position = 0
    while position < len(body):
        length = _remaining_length(body, position + 1)
        if length is None:
            break
        remaining, used = length
        start, end = position + 1 + used, position + 1 + used + remaining
        kinds.append(MQTT_TYPES[body[position] >> 4])
        if body[position] >> 4 == 3 and end <= len(body):
            publish = _publish(body[start:end], body[position] >> 1 & 3, 1 + used, aliases)
            if publish is not None:
                publishes.append(publish)
        position = end
    return tuple(kinds), tuple(publishes)


def _publish(rest: bytes, qos: int, fixed: int, aliases: Aliases) -> Publish | None:
    if len(rest) < 2:
        return None
    topic_end = 2 + struct.unpack_from("!H", rest)[0]
    properties = _remaining_length(rest, topic_end + (2 if qos else 0))
    if properties is None:
        return None
    size, used = properties
    start = topic_end + (2 if qos else 0) + used + size
    topic = rest[2:topic_end].decode("utf-8", errors="replace")
    alias = _topic_alias(rest[start - size : start])
    if alias is not None:
        topic = topic or aliases.get(alias, "")
        aliases[alias] = topic
    return Publish(topic, rest[start:], fixed + start)


def _topic_alias(properties: bytes) -> int | None:
    """The topic alias among a PUBLISH's properties, None without one."""
    position = 0
    while position < len(properties):
        kind = properties[position]
        position += 1
        if kind == _TOPIC_ALIAS:
            return int.from_bytes(properties[position : position + 2], "big")
        if kind in _FIXED_PROPERTIES:
            position += _FIXED_PROPERTIES[kind]
        elif kind in _TEXTS:
            for _ in range(_TEXTS[kind]):
                position += 2 + int.from_bytes(properties[position : position + 2], "big")
        else:
            number = _remaining_length(properties, position)
            if number is None:
                return None
            position += number[1]
    return None


def _remaining_length(data: bytes, position: int) -> tuple[int, int] | None:
    """A variable byte integer and how many bytes it took; None where it is cut off or none."""
    value = 0
    for used in range(1, 5):
        if position >= len(data):
            return None
        byte = data[position]
        value |= (byte & 0x7F) << 7 * (used - 1)
        if byte < 0x80:
            return value, used
        position += 1
    return None


def _address(data: bytes, start: int) -> str:
    return ".".join(str(byte) for byte in data[start : start + 4])
