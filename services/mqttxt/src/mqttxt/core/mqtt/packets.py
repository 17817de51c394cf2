"""MQTT 5 packets of the hot path: a PUBLISH at QoS 0, which is what states travel in, and where a packet ends.

All else is paho's: connecting, subscribing, QoS 1, and a PUBLISH that has properties.
"""

from __future__ import annotations

from ..effects import Inbound, Publish

PINGREQ = b"\xc0\x00"
PINGRESP = 0xD0
_PUBLISH, _RETAIN = 0x30, 0x01
_EXPIRY, _ALIAS = 0x02, 0x23
"""Properties of a PUBLISH (MQTT 5.0, 3.3.2.3)."""
_LONGEST_HEADER = 5
"""One byte of type and flags, and at most four of the length."""


def end_of(data: bytes, start: int) -> tuple[int, int]:
    """Where the body and the end of the packet at `start` are; 0 and 0 where its header is not whole yet.

    Raises ValueError for a length that no packet has.
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


def message_of(data: bytes, start: int, body: int, end: int) -> Inbound | None:
    """The message in a PUBLISH at QoS 0 without properties; None for any other packet. Raises UnicodeDecodeError."""
    if data[start] & ~_RETAIN != _PUBLISH or end - body < 3:
        return None
    topic = body + 2
    properties = topic + (data[body] << 8 | data[body + 1])
    if not topic < properties < end or data[properties] != 0:
        return None
    return Inbound(data[topic:properties].decode(), data[properties + 1 : end], 0, data[start] != _PUBLISH)


def publish(message: Publish, topic: str, alias: int | None) -> bytes:
    """A message as a PUBLISH at QoS 0, below a topic or an alias that has its place."""
    name = topic.encode()
    properties = b"" if message.expiry_s is None else bytes((_EXPIRY, *message.expiry_s.to_bytes(4, "big")))
    if alias is not None:
        properties += bytes((_ALIAS, alias >> 8, alias & 0xFF))
    body = b"".join((len(name).to_bytes(2, "big"), name, bytes((len(properties),)), properties, message.payload))
    return bytes((_PUBLISH | message.retain, *_length(len(body)))) + body


def _length(length: int) -> bytes:
    out = bytearray()
    while length > 0x7F:
        out.append(length & 0x7F | 0x80)
        length >>= 7
    out.append(length)
    return bytes(out)
