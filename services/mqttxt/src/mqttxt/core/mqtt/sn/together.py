"""Messages sent together, and messages in pieces: one stream of bytes, cut to the size of datagrams (R20.6).

In the stream a message is a head (flags, topic id, length of the name, length of the payload), the topic's name if the
id is 0, and the payload. The pieces arrive once and in order, as do the PUBLISHes at QoS 1 that carry them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from .topic_ids import TopicIds

MOST_BYTES = 65_536
"""The most bytes of one message with its head and topic."""
_HEAD = struct.Struct(">BHHH")
_RETAIN, _QOS = 0x10, 0x20


@dataclass(frozen=True)
class AirMessage:
    """A message to be sent, or received; `qos` is the publisher's."""

    topic: str
    payload: bytes
    qos: int = 1
    retain: bool = False


def pack(told: AirMessage, ids: TopicIds) -> bytes:
    """Encode a message for the stream."""
    topic_id = ids.id_of(told.topic)
    name = told.topic.encode() if topic_id is None else b""
    flags = _RETAIN * told.retain | _QOS * (told.qos > 0)
    return _HEAD.pack(flags, topic_id or 0, len(name), len(told.payload)) + name + told.payload


class Unpacker:
    """Decodes the stream piece by piece."""

    def __init__(self, ids: TopicIds) -> None:
        self._ids = ids
        self._came = b""

    def take(self, piece: bytes) -> list[AirMessage]:
        """The messages that end in this piece; raises ValueError if the stream is malformed, which ends it."""
        came, at, self._came = self._came + piece, 0, b""
        found: list[AirMessage] = []
        while len(came) - at >= _HEAD.size:
            flags, topic_id, name_length, length = _HEAD.unpack_from(came, at)
            begin = at + _HEAD.size + name_length
            if _HEAD.size + name_length + length > MOST_BYTES or (topic_id == 0) != (name_length > 0):
                raise ValueError(f"a message with topic id {topic_id}, {name_length} + {length} bytes")
            if len(came) < begin + length:
                break
            name = came[at + _HEAD.size : begin].decode() if topic_id == 0 else self._ids.topic_of(topic_id)
            if name is None:
                raise ValueError(f"topic id {topic_id}: not predefined")
            at = begin + length
            found.append(AirMessage(name, came[begin:at], int(flags & _QOS != 0), flags & _RETAIN != 0))
        self._came = came[at:]
        return found
