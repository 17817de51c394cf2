"""scapy layers for MQTT 5: the fifteen control packets with properties and reason codes (MQTT 5.0, section 3).

    from testbed.numbers.dissect import mqtt5
    mqtt5.bind()                                      # TCP 1883
    segment = scapy.Ether(data)
    segment[mqtt5.Publish].topic
    bytes(mqtt5.Publish(topic="a/b", qos=1, packet_id=7, properties={"topic_alias": 3}, message=b"12"))

Several packets in one segment are successive layers. A packet that continues in the next segment, and bytes that are
no packet, are Raw; scapy's TCPSession reassembles packets. The fixed header's `len` follows from the rest unless it is
given, and so does whether a reason code of 0 without properties is written. Bytes that fit no field of a packet's type
are its `malformed`. scapy's own contrib.mqtt is for 3.1.1: it has no properties, binds its port when it is imported,
and counts the packets that follow one into its length.
"""

from __future__ import annotations

from collections.abc import Callable

from scapy.fields import (
    BitEnumField,
    BitField,
    ByteEnumField,
    ByteField,
    ConditionalField,
    FieldListField,
    PacketListField,
    ShortField,
    StrField,
)
from scapy.layers.inet import TCP
from scapy.packet import Packet, bind_layers, split_layers

from .mqtt5_base import KINDS as KINDS
from .mqtt5_base import MQTT as MQTT
from .mqtt5_base import fixed_header, packet_fields, reason_and_properties
from .mqtt5_codes import DISCONNECT_REASONS, REASONS, RETAIN_HANDLING, SUBSCRIBE_REASONS
from .mqtt5_fields import Binary, Properties, Utf8String

PORT = 1883


def _if(flag: str) -> Callable[[Packet], bool]:
    return lambda pkt: bool(pkt.getfieldval(flag))


def _is_version_5(pkt: Packet) -> bool:
    return bool(pkt.getfieldval("protocol_version") == 5)


class Connect(MQTT):
    """CONNECT (3.1). The flags tell which fields follow the client identifier."""

    name = "MQTT CONNECT"
    fields_desc = packet_fields(
        1,
        0,
        Utf8String("protocol_name", "MQTT"),
        ByteField("protocol_version", 5),
        BitField("user_name_flag", 0, 1),
        BitField("password_flag", 0, 1),
        BitField("will_retain", 0, 1),
        BitField("will_qos", 0, 2),
        BitField("will_flag", 0, 1),
        BitField("clean_start", 1, 1),
        BitField("reserved", 0, 1),
        ShortField("keep_alive", 60),
        ConditionalField(Properties(), _is_version_5),
        Utf8String("client_id"),
        ConditionalField(Properties("will_properties"), lambda pkt: _if("will_flag")(pkt) and _is_version_5(pkt)),
        ConditionalField(Utf8String("will_topic"), _if("will_flag")),
        ConditionalField(Binary("will_message"), _if("will_flag")),
        ConditionalField(Utf8String("user_name"), _if("user_name_flag")),
        ConditionalField(Binary("password"), _if("password_flag")),
    )


class Connack(MQTT):
    """CONNACK (3.2)."""

    name = "MQTT CONNACK"
    fields_desc = packet_fields(
        2,
        0,
        BitField("reserved", 0, 7),
        BitField("session_present", 0, 1),
        ByteEnumField("reason_code", 0, REASONS),
        Properties(),
    )


class Publish(MQTT):
    """PUBLISH (3.3); `message` is its payload."""

    name = "MQTT PUBLISH"
    fields_desc = fixed_header(
        3,
        [BitField("dup", 0, 1), BitField("qos", 0, 2), BitField("retain", 0, 1)],
        Utf8String("topic"),
        ConditionalField(ShortField("packet_id", 1), _if("qos")),
        Properties(),
        StrField("message", b""),
    )

    def mysummary(self) -> str:
        alias = dict(self.getfieldval("properties")).get("topic_alias")
        return f"MQTT PUBLISH {self.getfieldval('topic') or f'alias {alias}'}"


class Puback(MQTT):
    """PUBACK (3.4)."""

    name = "MQTT PUBACK"
    fields_desc = packet_fields(4, 0, ShortField("packet_id", 1), *reason_and_properties(2, REASONS))


class Pubrec(MQTT):
    """PUBREC (3.5)."""

    name = "MQTT PUBREC"
    fields_desc = packet_fields(5, 0, ShortField("packet_id", 1), *reason_and_properties(2, REASONS))


class Pubrel(MQTT):
    """PUBREL (3.6)."""

    name = "MQTT PUBREL"
    fields_desc = packet_fields(6, 2, ShortField("packet_id", 1), *reason_and_properties(2, REASONS))


class Pubcomp(MQTT):
    """PUBCOMP (3.7)."""

    name = "MQTT PUBCOMP"
    fields_desc = packet_fields(7, 0, ShortField("packet_id", 1), *reason_and_properties(2, REASONS))


class Subscription(Packet):
    """A topic filter of a SUBSCRIBE with its options (3.8.3.1)."""

    name = "subscription"
    fields_desc = [
        Utf8String("filter"),
        BitField("reserved", 0, 2),
        BitEnumField("retain_handling", 0, 2, RETAIN_HANDLING),
        BitField("retain_as_published", 0, 1),
        BitField("no_local", 0, 1),
        BitField("qos", 0, 2),
    ]

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes | None]:
        return b"", s


class Subscribe(MQTT):
    """SUBSCRIBE (3.8)."""

    name = "MQTT SUBSCRIBE"
    fields_desc = packet_fields(
        8, 2, ShortField("packet_id", 1), Properties(), PacketListField("subscriptions", [], Subscription)
    )


class Suback(MQTT):
    """SUBACK (3.9): a reason code for each filter."""

    name = "MQTT SUBACK"
    fields_desc = packet_fields(
        9,
        0,
        ShortField("packet_id", 1),
        Properties(),
        FieldListField("reason_codes", [], ByteEnumField("", 0, SUBSCRIBE_REASONS)),
    )


class Unsubscribe(MQTT):
    """UNSUBSCRIBE (3.10)."""

    name = "MQTT UNSUBSCRIBE"
    fields_desc = packet_fields(
        10, 2, ShortField("packet_id", 1), Properties(), FieldListField("filters", [], Utf8String(""))
    )


class Unsuback(MQTT):
    """UNSUBACK (3.11): a reason code for each filter."""

    name = "MQTT UNSUBACK"
    fields_desc = packet_fields(
        11,
        0,
        ShortField("packet_id", 1),
        Properties(),
        FieldListField("reason_codes", [], ByteEnumField("", 0, REASONS)),
    )


class Pingreq(MQTT):
    """PINGREQ (3.12)."""

    name = "MQTT PINGREQ"
    fields_desc = packet_fields(12, 0)


class Pingresp(MQTT):
    """PINGRESP (3.13)."""

    name = "MQTT PINGRESP"
    fields_desc = packet_fields(13, 0)


class Disconnect(MQTT):
    """DISCONNECT (3.14)."""

    name = "MQTT DISCONNECT"
    fields_desc = packet_fields(14, 0, *reason_and_properties(0, DISCONNECT_REASONS))


class Auth(MQTT):
    """AUTH (3.15)."""

    name = "MQTT AUTH"
    fields_desc = packet_fields(15, 0, *reason_and_properties(0, REASONS))


KINDS.update({
    1: Connect, 2: Connack, 3: Publish, 4: Puback, 5: Pubrec, 6: Pubrel, 7: Pubcomp, 8: Subscribe, 9: Suback,
    10: Unsubscribe, 11: Unsuback, 12: Pingreq, 13: Pingresp, 14: Disconnect, 15: Auth,
})  # fmt: skip


def topic_of(publish: Publish, aliases: dict[int, str]) -> str:
    """The topic of a PUBLISH, also where it has an alias (3.3.2.3.4); empty for an alias without a topic so far.

    `aliases` are those of its connection and direction since the CONNECT; the PUBLISH's own is added.
    """
    topic: str = publish.getfieldval("topic")
    alias = dict(publish.getfieldval("properties")).get("topic_alias")
    if alias is None:
        return topic
    if topic:
        aliases[alias] = topic
    return aliases.get(alias, "")


def bind(port: int = PORT) -> None:
    """Let scapy dissect TCP to and from this port as MQTT 5."""
    bind_layers(TCP, MQTT, dport=port)
    bind_layers(TCP, MQTT, sport=port)


def unbind(port: int = PORT) -> None:
    """Undo `bind`."""
    split_layers(TCP, MQTT, dport=port)
    split_layers(TCP, MQTT, sport=port)
