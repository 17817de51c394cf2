"""scapy layers for MAVLink: frames of version 1 and 2, and every message of common.xml under its own name.

    from testbed.numbers.dissect import mavlink
    mavlink.bind()                                    # UDP 14540 to 14830
    frame = scapy.Ether(data)
    frame[mavlink.ATTITUDE].roll                      # messages and fields are named as in common.xml
    bytes(mavlink.MAVLink2(sysid=1, compid=1, message=mavlink.HEARTBEAT(type="MAV_TYPE_QUADROTOR")))

A frame's `len`, `msgid` and `checksum` follow from its message unless they are given. Several frames in one datagram
are successive layers. A message that the tables do not have, and bytes that are no complete frame, are Raw. The tables
are pymavlink's of development.xml: all of common.xml, unchanged, and planned additions such as CURRENT_MODE, which PX4
sends already. If a field has the name of an attribute of every scapy packet (`name`, `payload`, `time`, `direction`),
`message.getfieldval("name")` reads it. The format: https://mavlink.io/en/guide/serialization.html
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, cast

from pymavlink.dialects.v10 import common as version1
from pymavlink.dialects.v20 import development as dialect
from scapy.config import conf
from scapy.error import Scapy_Exception
from scapy.fields import (
    ByteField,
    ConditionalField,
    Field,
    LEThreeBytesField,
    XByteField,
    XLEShortField,
    XStrFixedLenField,
)
from scapy.layers.inet import UDP
from scapy.packet import Packet, Raw, bind_layers, split_layers

from .mavlink_fields import CharArray, Number, NumberArray

PORTS = tuple(range(14540, 14831))
"""UDP ports that PX4, MAVSDK, ground stations and the testbed's routers use, for drones 1 to 250."""
MAGIC_1, MAGIC_2 = dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2
HEADER_1, HEADER_2 = dialect.HEADER_LEN_V1, dialect.HEADER_LEN_V2
SIGNED = dialect.MAVLINK_IFLAG_SIGNED
_CHECKSUM, _SIGNATURE = 2, dialect.MAVLINK_SIGNATURE_BLOCK_LEN
_IDS: dict[str, int] = {cls.msgname: number for number, cls in dialect.mavlink_map.items()}


class Message(Packet):
    """A message: base of the classes that `message_class` makes."""

    msgid = -1

    def mysummary(self) -> str:
        return self.__class__.__name__

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes | None]:
        return s, None


class _HasPayload(Message):
    """A message with a field `payload`, which scapy, when it copies a packet, would take for the packet's payload."""

    def __iter__(self) -> Iterator[Packet]:
        yield self


@cache
def message_class(msgid: int) -> type[Message] | None:
    """The class of a message by its number; None if the tables do not have it."""
    table = dialect.mavlink_map.get(msgid)
    if table is None:
        return None
    base = _HasPayload if "payload" in table.fieldnames else Message
    members = {"fields_desc": _fields_of(table), "msgid": msgid, "__doc__": (table.__doc__ or "").strip()}
    made: Any = type(table.msgname, (base,), members)
    if "command" in table.fieldnames:  # scapy's method of this name returns a packet as Python code
        made.command = property(lambda self: self.getfieldval("command"))
    return cast(type[Message], made)


def message_of(name: str) -> type[Message]:
    """The class of a message by its name. Raises AttributeError if the tables do not have it."""
    if name not in _IDS:
        raise AttributeError(f"{name}: no message of pymavlink's tables")
    made = message_class(_IDS[name])
    assert made is not None
    return made


def __getattr__(name: str) -> type[Message]:
    return message_of(name)


def _fields_of(table: Any) -> list[Field[Any, Any]]:
    """The fields in wire order (largest type first, extensions last)."""
    found: list[Field[Any, Any]] = []
    for name in table.ordered_fieldnames:
        place = table.fieldnames.index(name)
        kind, count = table.fieldtypes[place], table.array_lengths[table.ordered_fieldnames.index(name)]
        unit = table.fieldunits_by_name.get(name, "")
        if kind == "char" and count:
            found.append(CharArray(name, count))
        elif count:
            found.append(NumberArray(name, kind, count, unit))
        else:
            values = dialect.enums.get(table.fieldenums_by_name.get(name), {})
            names = {n: entry.name for n, entry in values.items() if not entry.name.endswith("_ENUM_END")}
            found.append(Number(name, kind, names, unit, table.fielddisplays_by_name.get(name) == "bitmask"))
    return found


class _MessageId(Field[Any, Any]):
    """A message's number; None stands for that of the frame's message."""

    __slots__: list[str] = []

    def i2m(self, pkt: Packet | None, x: Any) -> Any:
        if x is None:
            message = pkt.getfieldval("message") if pkt is not None else None
            if not isinstance(message, Message):
                raise Scapy_Exception("a MAVLink frame needs a message, or msgid, len and checksum")
            return message.msgid
        return x

    def i2repr(self, pkt: Packet | None, x: Any) -> str:
        known = dialect.mavlink_map.get(x)
        return f"{x} ({known.msgname})" if known is not None else repr(x)


class _ShortId(_MessageId):
    def __init__(self) -> None:
        super().__init__("msgid", None, "B")


class _LongId(_MessageId, LEThreeBytesField):
    def __init__(self) -> None:
        LEThreeBytesField.__init__(self, "msgid", None)

    def addfield(self, pkt: Packet, s: bytes, val: Any) -> bytes:
        return s + int(self.i2m(pkt, val)).to_bytes(3, "little")


class _MessageField(Field[Any, Any]):
    """The frame's message: `len` bytes, filled up with the zeros that version 2 omits."""

    __slots__: list[str] = []
    holds_packets = 1

    def __init__(self) -> None:
        super().__init__("message", None)

    def getfield(self, pkt: Packet, s: bytes) -> tuple[bytes, Packet]:
        length = int(pkt.fields["len"])
        body, rest = s[:length], s[length:]
        cls = message_class(pkt.fields["msgid"])
        if cls is None:
            return rest, Raw(body)
        return rest, cls(body.ljust(_size_of(cls), b"\0"), _internal=1)

    def addfield(self, pkt: Packet, s: bytes, val: Any) -> bytes:
        body = bytes(val) if val is not None else b""
        length = pkt.getfieldval("len")
        if length is not None:
            return s + body.ljust(length, b"\0")[:length]
        if isinstance(pkt, MAVLink1):
            return s + body[: _size_in_version1(val)]
        return s + (body.rstrip(b"\0") or body[:1])


class MAVLink(Packet):
    """A MAVLink frame of either version: `MAVLink(data)` is of the class for its first byte.

    Bytes that are no complete frame are Raw.
    """

    name = "MAVLink"
    header = HEADER_2

    @classmethod
    def dispatch_hook(cls, _pkt: bytes | None = None, *_: Any, **__: Any) -> type[Packet]:
        if _pkt is None:
            return MAVLink2
        kind = _kind_of(_pkt)
        return kind if kind is not None else conf.raw_layer

    def default_payload_class(self, payload: bytes) -> type[Packet]:
        return _kind_of(payload) or conf.raw_layer

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        end = len(pkt) - (_SIGNATURE if self.is_signed else 0) - _CHECKSUM
        made = bytearray(pkt)
        if self.getfieldval("len") is None:
            made[1] = end - self.header
        if self.getfieldval("checksum") is None:
            made[end : end + _CHECKSUM] = self._checksum(bytes(made[1:end])).to_bytes(2, "little")
        return bytes(made) + pay

    @property
    def is_signed(self) -> bool:
        return False

    @property
    def checksum_is_right(self) -> bool | None:
        """Whether a frame's checksum fits its bytes; None for a message that is not in the tables."""
        whole = bytes(self)
        end = self.header + whole[1]
        if message_class(self.getfieldval("msgid")) is None:
            return None
        return self._checksum(whole[1:end]) == int.from_bytes(whole[end : end + _CHECKSUM], "little")

    def _checksum(self, covered: bytes) -> int:
        msgid = int.from_bytes(covered[self.header - 4 : self.header - 1], "little")
        if self.header == HEADER_1:
            msgid = covered[HEADER_1 - 2]
        table = dialect.mavlink_map.get(msgid)
        if table is None:
            raise Scapy_Exception(f"MAVLink message {msgid} is not in pymavlink's tables: give its checksum")
        crc = dialect.x25crc(covered)
        crc.accumulate(bytes([table.crc_extra]))
        return int(crc.crc)

    def mysummary(self) -> str:
        message = self.getfieldval("message")
        what = message.__class__.__name__ if isinstance(message, Message) else f"message {self.getfieldval('msgid')}"
        return f"{self.name} {self.getfieldval('sysid')}:{self.getfieldval('compid')} {what}"

    def _command(self, json: bool = False) -> list[tuple[str, Any]]:
        if json:
            return super()._command(json=True)
        values = self.fields.items()
        return [(name, Packet.command(value) if isinstance(value, Packet) else repr(value)) for name, value in values]


class MAVLink1(MAVLink):
    """A frame of version 1: short header, no extensions, all zeros sent."""

    name = "MAVLink 1"
    header = HEADER_1
    fields_desc = [
        XByteField("magic", MAGIC_1),
        ByteField("len", None),
        ByteField("seq", 0),
        ByteField("sysid", 255),
        ByteField("compid", 190),
        _ShortId(),
        _MessageField(),
        XLEShortField("checksum", None),
    ]


class MAVLink2(MAVLink):
    """A frame of version 2: flags, a message number of three bytes, trailing zeros omitted, optionally signed."""

    name = "MAVLink 2"
    fields_desc = [
        XByteField("magic", MAGIC_2),
        ByteField("len", None),
        XByteField("incompat_flags", 0),
        XByteField("compat_flags", 0),
        ByteField("seq", 0),
        ByteField("sysid", 255),
        ByteField("compid", 190),
        _LongId(),
        _MessageField(),
        XLEShortField("checksum", None),
        ConditionalField(ByteField("link_id", 0), lambda pkt: pkt.is_signed),
        ConditionalField(XStrFixedLenField("timestamp", bytes(6), length=6), lambda pkt: pkt.is_signed),
        ConditionalField(XStrFixedLenField("signature", bytes(6), length=6), lambda pkt: pkt.is_signed),
    ]

    @property
    def is_signed(self) -> bool:
        return bool(self.getfieldval("incompat_flags") & SIGNED)


def _kind_of(data: bytes) -> type[MAVLink] | None:
    """The class of the complete frame at the start of `data`; None without one."""
    if data[:1] == bytes([MAGIC_1]):
        whole = len(data) >= 2 and len(data) >= HEADER_1 + data[1] + _CHECKSUM
        return MAVLink1 if whole else None
    if data[:1] != bytes([MAGIC_2]) or len(data) < HEADER_2:
        return None
    behind = _CHECKSUM + (_SIGNATURE if data[2] & SIGNED else 0)
    return MAVLink2 if len(data) >= HEADER_2 + data[1] + behind else None


def _size_of(cls: type[Message]) -> int:
    return int(dialect.mavlink_map[cls.msgid].unpacker.size)


def _size_in_version1(message: Any) -> int | None:
    """A message's size without extensions; None (no limit) for one that version 1 does not have."""
    table = version1.mavlink_map.get(message.msgid) if isinstance(message, Message) else None
    return int(table.unpacker.size) if table is not None else None


def bind(ports: tuple[int, ...] = PORTS) -> None:
    """Let scapy dissect UDP to and from these ports as MAVLink."""
    for port in ports:
        bind_layers(UDP, MAVLink, dport=port)
        bind_layers(UDP, MAVLink, sport=port)


def unbind(ports: tuple[int, ...] = PORTS) -> None:
    """Undo `bind`."""
    for port in ports:
        split_layers(UDP, MAVLink, dport=port)
        split_layers(UDP, MAVLink, sport=port)
