"""MQTT 5 packets that pass paho by: what leaves at QoS 0, every PUBLISH that comes, and where a packet ends.

paho takes 0.4 s for 64 KiB of a PUBLISH's properties, which any publisher may send, and which brokers pass on.
"""

from __future__ import annotations

from ..effects import Publish

PINGREQ = b"\xc0\x00"
PINGRESP = 0xD0
KIND, PUBLISH, RETAIN = 0xF0, 0x30, 0x01
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


def message_of(data: bytes, start: int, body: int, end: int) -> tuple[bytes, bytes, int, int]:
    """Topic, payload, QoS and packet id (0 at QoS 0) of a PUBLISH; its properties are passed over, whatever they are.

    Raises ValueError for what nobody has subscribed to (QoS 2, a topic alias alone) and for what is no PUBLISH.
    """
    qos = data[start] >> 1 & 3
    if qos > 1:
        raise ValueError(f"a PUBLISH at QoS {qos}; expected 0 or 1")
    topic, mid = body + 2, 0
    topic_end = topic + (data[body] << 8 | data[body + 1]) if topic < end else 0
    properties = topic_end + 2 * qos
    if not topic < topic_end <= properties < end:
        raise ValueError("a PUBLISH without a topic, or that ends before its payload")
    if qos:
        mid = data[topic_end] << 8 | data[topic_end + 1]
    payload = properties + 1
    if data[properties] != 0:
        _, payload = end_of(data, properties - 1)  # which has their length where a packet has its own
        if not properties < payload <= end:
            raise ValueError("a PUBLISH that ends before its payload")
    return data[topic:topic_end], data[payload:end], qos, mid


def publish(message: Publish, topic: str, alias: int | None) -> bytes:
    """A message as a PUBLISH at QoS 0, below a topic or an alias that has its place."""
    name = topic.encode()
    properties = b"" if message.expiry_s is None else bytes((_EXPIRY, *message.expiry_s.to_bytes(4, "big")))
    if alias is not None:
        properties += bytes((_ALIAS, alias >> 8, alias & 0xFF))
    body = b"".join((len(name).to_bytes(2, "big"), name, bytes((len(properties),)), properties, message.payload))
    return bytes((PUBLISH | message.retain, *_length(len(body)))) + body


def _length(length: int) -> bytes:
    out = bytearray()
    while length > 0x7F:
        out.append(length & 0x7F | 0x80)
        length >>= 7
    out.append(length)
    return bytes(out)
