"""The packets of MQTT-SN 1.2 that are used here.

QoS 2, sleeping clients, changes of a will, forwarding and the discovery of gateways are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

NORMAL, PREDEFINED = 0, 1
"""Types of a topic id: registered on this connection, or known to both sides."""
CONGESTION, INVALID_TOPIC, NOT_SUPPORTED = 0x01, 0x02, 0x03
"""MQTT-SN's own return codes."""
FIRST_OF_MQTT_5 = 0x10
"""From here on a return code is an MQTT 5 reason code (R20.8)."""


@dataclass(frozen=True)
class Connect:
    """`has_will`: the gateway asks for the will before it answers. `duration_s` is the keep-alive."""

    client_id: str
    duration_s: int
    has_will: bool = False
    is_clean: bool = True
    KIND: ClassVar[int] = 0x04


@dataclass(frozen=True)
class Connack:
    code: int = 0
    KIND: ClassVar[int] = 0x05


@dataclass(frozen=True)
class WillTopicReq:
    KIND: ClassVar[int] = 0x06


@dataclass(frozen=True)
class WillTopic:
    topic: str
    qos: int = 1
    retain: bool = True
    KIND: ClassVar[int] = 0x07


@dataclass(frozen=True)
class WillMsgReq:
    KIND: ClassVar[int] = 0x08


@dataclass(frozen=True)
class WillMsg:
    payload: bytes
    KIND: ClassVar[int] = 0x09


@dataclass(frozen=True)
class Register:
    topic_id: int
    msg_id: int
    topic: str
    KIND: ClassVar[int] = 0x0A


@dataclass(frozen=True)
class Regack:
    topic_id: int
    msg_id: int
    code: int = 0
    KIND: ClassVar[int] = 0x0B


@dataclass(frozen=True)
class Message:
    """A PUBLISH at QoS 0 or 1; `msg_id` is 0 at QoS 0."""

    topic_id: int
    payload: bytes
    id_type: int = PREDEFINED
    qos: int = 0
    msg_id: int = 0
    retain: bool = False
    dup: bool = False
    KIND: ClassVar[int] = 0x0C


@dataclass(frozen=True)
class Puback:
    topic_id: int
    msg_id: int
    code: int = 0
    KIND: ClassVar[int] = 0x0D


@dataclass(frozen=True)
class Subscribe:
    """A SUBSCRIBE to a filter, or to a predefined topic by its id; `live_only` as in `core.effects.Subscribe`."""

    msg_id: int
    topic: str | int
    qos: int = 1
    dup: bool = False
    live_only: bool = False
    KIND: ClassVar[int] = 0x12


@dataclass(frozen=True)
class Suback:
    topic_id: int
    msg_id: int
    code: int = 0
    qos: int = 1
    KIND: ClassVar[int] = 0x13


@dataclass(frozen=True)
class Unsubscribe:
    msg_id: int
    topic: str | int
    KIND: ClassVar[int] = 0x14


@dataclass(frozen=True)
class Unsuback:
    msg_id: int
    KIND: ClassVar[int] = 0x15


@dataclass(frozen=True)
class Pingreq:
    KIND: ClassVar[int] = 0x16


@dataclass(frozen=True)
class Pingresp:
    KIND: ClassVar[int] = 0x17


@dataclass(frozen=True)
class Disconnect:
    """A DISCONNECT; in 1.2 a duration means a sleeping client, which our gateway does not serve."""

    duration_s: int | None = None
    KIND: ClassVar[int] = 0x18


Packet = (
    Connect
    | Connack
    | WillTopicReq
    | WillTopic
    | WillMsgReq
    | WillMsg
    | Register
    | Regack
    | Message
    | Puback
    | Subscribe
    | Suback
    | Unsubscribe
    | Unsuback
    | Pingreq
    | Pingresp
    | Disconnect
)
