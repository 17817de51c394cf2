"""MQTT 5 packets that bypass paho: every PUBLISH and PUBACK, and the end of each packet.

paho needs 0.4 s for 64 KiB of a PUBLISH's properties, which any publisher may send and which brokers pass on, and more
time for each PUBACK than an activator needs for a state.
"""

from __future__ import annotations

from ..effects import Publish
from .aliases import BrokersAliases

PINGREQ = b"\xc0\x00"
PINGRESP = 0xD0
KIND, PUBLISH, PUBACK, RETAIN = 0xF0, 0x30, 0x40, 0x01
_EXPIRY, _ALIAS, _SUBSCRIPTION = 0x02, 0x23, 0x0B
_FIXED_BYTES = {0x01: 1, _EXPIRY: 4}
_STRINGS = {0x03: 1, 0x08: 1, 0x09: 1, 0x26: 2}
"""Properties of a PUBLISH (MQTT 5.0, 3.3.2.3): the bytes of those with a fixed length, the strings in the others."""
_ACKNOWLEDGED = frozenset((0x00, 0x10, 0x80, 0x83, 0x87, 0x90, 0x91, 0x97, 0x99))
"""The reason codes of a PUBACK (MQTT 5.0, 3.4.2.1)."""
_LONGEST_HEADER = 5
"""Bytes: one for type and flags, and at most four for the length."""


def end_of(data: bytes, start: int) -> tuple[int, int]:
    """The offsets of the body and the end of the packet at `start`; 0 and 0 if its header is incomplete.

    Raises ValueError for a length of more than four bytes.
    """
    length = shift = 0
    for at in range(start + 1, start + _LONGEST_HEADER):
        if at >= len(data):
            return 0, 0
        length |= (data[at] & 0x7F) << shift
        if data[at] < 0x80:
            return at + 1, at + 1 + length
        shift += 7
    raise ValueError("a packet's length of more than four bytes")


def message_of(data: bytes, start: int, body: int, end: int, aliases: BrokersAliases) -> tuple[bytes, bytes, int, int]:
    """Topic, payload, QoS and packet id (0 at QoS 0) of a PUBLISH; of its properties only an alias is read.

    Raises ValueError for QoS 2, which nobody has subscribed to, for an unknown alias, and for a malformed PUBLISH.
    """
    qos = data[start] >> 1 & 3
    if qos > 1:
        raise ValueError(f"a PUBLISH at QoS {qos}; expected 0 or 1")
    topic, mid = body + 2, 0
    topic_end = topic + (data[body] << 8 | data[body + 1]) if topic < end else 0
    properties = topic_end + 2 * qos
    if not topic <= topic_end <= properties < end:
        raise ValueError("a PUBLISH that ends before its payload")
    if qos:
        mid = data[topic_end] << 8 | data[topic_end + 1]
    payload, name = properties + 1, data[topic:topic_end]
    if data[properties] != 0:
        begin, payload = end_of(data, properties - 1)  # their length is encoded like a packet's
        if not properties < payload <= end:
            raise ValueError("a PUBLISH that ends before its payload")
        if aliases.maximum:
            name = aliases.topic(name, _alias_of(data[begin:payload]))
    if not name:
        raise ValueError("a PUBLISH without a topic")
    return name, data[payload:end], qos, mid


def _alias_of(properties: bytes) -> int | None:
    """The topic alias among properties; None if none precedes a property that no PUBLISH has."""
    at, end = 0, len(properties)
    while at < end:
        kind, at = properties[at], at + 1
        if kind == _ALIAS:
            return int.from_bytes(properties[at : at + 2], "big")
        if kind == _SUBSCRIPTION:
            at = end_of(properties, at - 1)[0] or end
        elif kind in _STRINGS:
            for _ in range(_STRINGS[kind]):
                at += 2 + int.from_bytes(properties[at : at + 2], "big")
        else:
            at += _FIXED_BYTES.get(kind, end)
    return None


def puback(mid: int) -> bytes:
    """Encode the PUBACK of a message that was accepted."""
    return bytes((PUBACK, 2, mid >> 8, mid & 0xFF))


def acknowledged(data: bytes, body: int, end: int) -> tuple[int, int]:
    """Packet id and reason code of a PUBACK; its properties are not read. Raises ValueError for a malformed one."""
    if end - body < 2:
        raise ValueError("a PUBACK without a packet id")
    code = data[body + 2] if end - body > 2 else 0
    if code not in _ACKNOWLEDGED:
        raise ValueError(f"a PUBACK with the reason code {code:#x}")
    return data[body] << 8 | data[body + 1], code


def publish(message: Publish, topic: str, alias: int | None, mid: int | None = None) -> bytes:
    """Encode a message as a PUBLISH, at QoS 1 if it has a packet id; with an alias `topic` may be empty."""
    name = topic.encode()
    properties = b"" if message.expiry_s is None else bytes((_EXPIRY, *message.expiry_s.to_bytes(4, "big")))
    if alias is not None:
        properties += bytes((_ALIAS, alias >> 8, alias & 0xFF))
    own = (mid.to_bytes(2, "big") if mid is not None else b"") + bytes((len(properties),))
    length = 2 + len(name) + len(own) + len(properties) + len(message.payload)
    first = PUBLISH | (mid is not None) << 1 | message.retain
    head = bytes((first, length)) if length < 0x80 else bytes((first, *_length(length)))
    size = len(name).to_bytes(2, "big")
    return b"".join((head, size, name, own, properties, message.payload))


def _length(length: int) -> bytes:
    out = bytearray()
    while length > 0x7F:
        out.append(length & 0x7F | 0x80)
        length >>= 7
    out.append(length)
    return bytes(out)
