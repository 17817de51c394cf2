"""The common part of MQTT 5's control packets: the fixed header, and the split of a stream into packets (2.1)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from scapy.config import conf
from scapy.fields import BitEnumField, BitField, ByteEnumField, ConditionalField, Field, StrField
from scapy.packet import Packet

from .mqtt5_codes import TYPES
from .mqtt5_fields import MalformedError, Properties, VariableByteInteger, read_variable, write_variable

Fields = list[Any]


class MQTT(Packet):
    """An MQTT 5 control packet: `MQTT(data)` is of the class for its first byte, Raw if there is no complete one."""

    name = "MQTT 5"

    @classmethod
    def dispatch_hook(cls, _pkt: bytes | None = None, *_: Any, **__: Any) -> type[Packet]:
        return conf.raw_layer if _pkt is None else _kind_of(_pkt) or conf.raw_layer

    @classmethod
    def tcp_reassemble(cls, data: bytes, metadata: dict[str, Any], session: dict[str, Any]) -> Packet | None:
        """For scapy's TCPSession: the first packet once it is complete, the bytes after it as padding."""
        kind, end = _kind_of(data), whole_length(data)
        if kind is None or end is None:
            return None
        packet = kind(data[:end])
        return packet / conf.padding_layer(data[end:]) if data[end:] else packet

    def do_dissect(self, s: bytes) -> bytes:
        """Dissect the packet's own bytes, by its remaining length; those after them belong to the next packet."""
        end = whole_length(s)
        if end is None or end > len(s):
            raise MalformedError("no whole MQTT packet")
        left = s[:end]
        self.raw_packet_cache_fields = {}
        for field in self.fields_desc[:-1]:
            try:
                left, value = field.getfield(self, left)
            except (MalformedError, struct.error):
                break
            if value is None:
                continue
            if field.islist or field.holds_packets or field.ismutable:
                kept = self._raw_packet_cache_field_value(field, value, copy=True)
                self.raw_packet_cache_fields[field.name] = kept
            self.fields[field.name] = value
        if left:
            self.fields["malformed"] = left
        self.raw_packet_cache = s[:end]
        self.explicit = 1
        return s[end:]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        if self.getfieldval("len") is None:
            pkt = pkt[:1] + write_variable(len(pkt) - 2) + pkt[2:]
        return pkt + pay

    def default_payload_class(self, payload: bytes) -> type[Packet]:
        return _kind_of(payload) or conf.raw_layer

    def mysummary(self) -> str:
        return f"MQTT {TYPES[self.getfieldval('type')]}"


def packet_fields(kind: int, flags: int, *body: Field[Any, Any] | ConditionalField) -> Fields:
    """The fields of a control packet: the fixed header, its own, and `malformed` for bytes that fit none."""
    return fixed_header(kind, [BitField("flags", flags, 4)], *body)


def fixed_header(kind: int, flags: Fields, *body: Any) -> Fields:
    """As `packet_fields`, for a packet whose flags have names."""
    malformed = ConditionalField(StrField("malformed", b""), lambda pkt: bool(pkt.fields.get("malformed")))
    return [BitEnumField("type", kind, 4, TYPES), *flags, VariableByteInteger("len", None), *body, malformed]


def reason_and_properties(before: int, names: dict[int, str]) -> Fields:
    """Reason code and properties, which a sender may omit at the end (3.4.2.1), after `before` bytes."""

    def has(least: int, names: tuple[str, ...]) -> Callable[[Packet], bool]:
        def present(pkt: Packet) -> bool:
            length = pkt.fields.get("len")
            return any(pkt.fields.get(name) for name in names) if length is None else length >= least

        return present

    return [
        ConditionalField(
            ByteEnumField("reason_code", 0, names), has(before + 1, ("reason_code", "properties", "malformed"))
        ),
        ConditionalField(Properties(), has(before + 2, ("properties", "malformed"))),
    ]


KINDS: dict[int, type[MQTT]] = {}
"""The classes by their type's number; `mqtt5` fills it."""


def whole_length(data: bytes) -> int | None:
    """The length of the packet at the start of `data`, its fixed header included; None if it is not known yet."""
    try:
        remaining, start = read_variable(data, 1)
    except MalformedError:
        return None
    return start + remaining


def _kind_of(data: bytes) -> type[MQTT] | None:
    """The class of the complete packet at the start of `data`; None without one."""
    length = whole_length(data)
    return KINDS.get(data[0] >> 4) if length is not None and length <= len(data) else None
