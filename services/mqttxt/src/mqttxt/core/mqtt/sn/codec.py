"""Encodes and decodes the packets of MQTT-SN 1.2. A datagram is one packet."""

from __future__ import annotations

import struct
from collections.abc import Callable

from .packets import (
    NORMAL,
    PREDEFINED,
    Connack,
    Connect,
    Disconnect,
    Message,
    Packet,
    Pingreq,
    Pingresp,
    Puback,
    Regack,
    Register,
    Suback,
    Subscribe,
    Unsuback,
    Unsubscribe,
    WillMsg,
    WillMsgReq,
    WillTopic,
    WillTopicReq,
)

_DUP, _RETAIN, _WILL, _CLEAN, _TYPE = 0x80, 0x10, 0x08, 0x04, 0x03
_LIVE_ONLY = _RETAIN
"""In a SUBSCRIBE, where 1.2 gives this flag no meaning."""
_PROTOCOL = 0x01
_LONG_LENGTH = 0x01
_LONGEST_SHORT = 0xFF
_LONGEST = 0xFFFF
_OVERHEAD = 9
"""The most bytes of a PUBLISH besides its payload."""


def encode(packet: Packet) -> bytes:
    """Encode a packet as a datagram; raises ValueError if that has more than 65,535 bytes."""
    body = bytes((packet.KIND,)) + _body(packet)
    if len(body) + 1 <= _LONGEST_SHORT:
        return bytes((len(body) + 1,)) + body
    length = len(body) + 3
    if length > _LONGEST:
        raise ValueError(f"a packet of {length} bytes; expected at most {_LONGEST}")
    return bytes((_LONG_LENGTH,)) + length.to_bytes(2, "big") + body


def size_of_publish(payload: bytes) -> int:
    """An upper bound of the datagram's bytes for a PUBLISH with this payload."""
    return _OVERHEAD + len(payload)


def decode(datagram: bytes) -> Packet:
    """Decode the packet of a datagram; raises ValueError, with the reason, if it is none of those in `packets`."""
    start = 3 if datagram[:1] == bytes((_LONG_LENGTH,)) else 1
    if len(datagram) <= start:
        raise ValueError(f"{len(datagram)} bytes; expected a length and a kind")
    length = datagram[0] if start == 1 else int.from_bytes(datagram[1:3], "big")
    if length != len(datagram):
        raise ValueError(f"length {length} of a datagram of {len(datagram)} bytes")
    read = _READERS.get(datagram[start])
    if read is None:
        raise ValueError(f"packet kind 0x{datagram[start]:02x}: not spoken here")
    try:
        return read(datagram[start + 1 :])
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"packet kind 0x{datagram[start]:02x}: {error}") from error


def _body(packet: Packet) -> bytes:
    match packet:
        case Connect():
            flags = _WILL * packet.has_will | _CLEAN * packet.is_clean
            return struct.pack(">BBH", flags, _PROTOCOL, packet.duration_s) + packet.client_id.encode()
        case WillTopic():
            return bytes((packet.qos << 5 | _RETAIN * packet.retain,)) + packet.topic.encode()
        case WillMsg():
            return packet.payload
        case Register():
            return struct.pack(">HH", packet.topic_id, packet.msg_id) + packet.topic.encode()
        case Regack() | Puback():
            return struct.pack(">HHB", packet.topic_id, packet.msg_id, packet.code)
        case Message():
            flags = _DUP * packet.dup | packet.qos << 5 | _RETAIN * packet.retain | packet.id_type
            return struct.pack(">BHH", flags, packet.topic_id, packet.msg_id) + packet.payload
        case Subscribe():
            flags = _DUP * packet.dup | packet.qos << 5 | _LIVE_ONLY * packet.live_only
            return _subscription(flags, packet.msg_id, packet.topic)
        case Unsubscribe():
            return _subscription(0, packet.msg_id, packet.topic)
        case Suback():
            return struct.pack(">BHHB", packet.qos << 5, packet.topic_id, packet.msg_id, packet.code)
        case Unsuback():
            return packet.msg_id.to_bytes(2, "big")
        case Connack():
            return bytes((packet.code,))
        case Disconnect():
            return b"" if packet.duration_s is None else packet.duration_s.to_bytes(2, "big")
        case WillTopicReq() | WillMsgReq() | Pingreq() | Pingresp():
            return b""


def _subscription(flags: int, msg_id: int, topic: str | int) -> bytes:
    if isinstance(topic, int):
        return struct.pack(">BHH", flags | PREDEFINED, msg_id, topic)
    return struct.pack(">BH", flags, msg_id) + topic.encode()


def _split(body: bytes, layout: str) -> tuple[tuple[int, ...], bytes]:
    """Split a body into its leading numbers and the rest."""
    size = struct.calcsize(layout)
    return struct.unpack(layout, body[:size]), body[size:]


def _whole(body: bytes, layout: str) -> tuple[int, ...]:
    return struct.unpack(layout, body)


def _text(data: bytes, what: str) -> str:
    if not data:
        raise ValueError(f"{what}: expected at least one character")
    return data.decode()


def _qos(flags: int) -> int:
    qos = flags >> 5 & 3
    if qos > 1:
        raise ValueError(f"QoS {'-1' if qos == 3 else qos}: expected 0 or 1")
    return qos


def _connect(body: bytes) -> Connect:
    (flags, protocol, duration_s), rest = _split(body, ">BBH")
    if protocol != _PROTOCOL:
        raise ValueError(f"protocol {protocol}: expected {_PROTOCOL}, which is MQTT-SN 1.2")
    return Connect(_text(rest, "client id"), duration_s, flags & _WILL != 0, flags & _CLEAN != 0)


def _will_topic(body: bytes) -> WillTopic:
    (flags,), rest = _split(body, ">B")
    return WillTopic(_text(rest, "will topic"), _qos(flags), flags & _RETAIN != 0)


def _register(body: bytes) -> Register:
    (topic_id, msg_id), rest = _split(body, ">HH")
    return Register(topic_id, msg_id, _text(rest, "topic"))


def _message(body: bytes) -> Message:
    (flags, topic_id, msg_id), payload = _split(body, ">BHH")
    kind, qos = flags & _TYPE, _qos(flags)
    if kind not in (NORMAL, PREDEFINED):
        raise ValueError(f"topic id type {kind}: expected {NORMAL} or {PREDEFINED}")
    if (msg_id == 0) != (qos == 0):
        raise ValueError(f"message id {msg_id} at QoS {qos}: expected 0 at QoS 0, another one at QoS 1")
    return Message(topic_id, payload, kind, qos, msg_id, flags & _RETAIN != 0, flags & _DUP != 0)


def _topic(flags: int, rest: bytes) -> str | int:
    kind = flags & _TYPE
    if kind == PREDEFINED:
        return _whole(rest, ">H")[0]
    if kind != NORMAL:
        raise ValueError(f"topic id type {kind}: expected {NORMAL} or {PREDEFINED}")
    return _text(rest, "topic filter")


def _subscribe(body: bytes) -> Subscribe:
    (flags, msg_id), rest = _split(body, ">BH")
    return Subscribe(msg_id, _topic(flags, rest), _qos(flags), flags & _DUP != 0, flags & _LIVE_ONLY != 0)


def _unsubscribe(body: bytes) -> Unsubscribe:
    (flags, msg_id), rest = _split(body, ">BH")
    return Unsubscribe(msg_id, _topic(flags, rest))


def _suback(body: bytes) -> Suback:
    flags, topic_id, msg_id, code = _whole(body, ">BHHB")
    return Suback(topic_id, msg_id, code, _qos(flags))


def _disconnect(body: bytes) -> Disconnect:
    return Disconnect(_whole(body, ">H")[0] if body else None)


def _empty(packet: Packet) -> Callable[[bytes], Packet]:
    def read(body: bytes) -> Packet:
        if body:
            raise ValueError(f"{len(body)} bytes behind the kind 0x{packet.KIND:02x}: expected none")
        return packet

    return read


def _pingreq(_body: bytes) -> Pingreq:
    """A PINGREQ; the id of a sleeping client, which may follow, is ignored."""
    return Pingreq()


_READERS: dict[int, Callable[[bytes], Packet]] = {
    Connect.KIND: _connect,
    Connack.KIND: lambda body: Connack(*_whole(body, ">B")),
    WillTopicReq.KIND: _empty(WillTopicReq()),
    WillTopic.KIND: _will_topic,
    WillMsgReq.KIND: _empty(WillMsgReq()),
    WillMsg.KIND: lambda body: WillMsg(body),
    Register.KIND: _register,
    Regack.KIND: lambda body: Regack(*_whole(body, ">HHB")),
    Message.KIND: _message,
    Puback.KIND: lambda body: Puback(*_whole(body, ">HHB")),
    Subscribe.KIND: _subscribe,
    Suback.KIND: _suback,
    Unsubscribe.KIND: _unsubscribe,
    Unsuback.KIND: lambda body: Unsuback(*_whole(body, ">H")),
    Pingreq.KIND: _pingreq,
    Pingresp.KIND: _empty(Pingresp()),
    Disconnect.KIND: _disconnect,
}
