"""MQTT 5 properties: what we announce to a broker, what it allows us, and those of a publish."""

from __future__ import annotations

from dataclasses import dataclass

from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

LARGEST_PACKET = 65_536
"""Bytes; announced to the broker, which must not send more (MQTT 5.0, 3.1.2.11.4)."""
MOST_ALIASES = 4096
MOST_RECEIVED = 1000
"""Receive Maximum: QoS 1 publishes that the broker may send ahead of our acknowledgement."""
MOST_IN_FLIGHT = 100
"""Our QoS 1 publishes ahead of the broker's acknowledgement, if it allows as many."""
_OVERHEAD = 32
"""Bytes of a PUBLISH beside topic and payload, at most: header 5, lengths 3, packet id 2, alias 3, expiry 5."""


def expiry_properties(expiry_s: int | None) -> Properties | None:
    """Those of a PUBLISH that expires, None where it does not."""
    if expiry_s is None:
        return None
    properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
    properties.MessageExpiryInterval = expiry_s
    return properties


def connect_properties(session_expiry_s: int, aliases: int) -> Properties:
    """Those of a CONNECT: how long the session outlives the connection, and what may be sent to us."""
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.SessionExpiryInterval = session_expiry_s
    properties.MaximumPacketSize = LARGEST_PACKET
    properties.ReceiveMaximum = MOST_RECEIVED
    if aliases:
        properties.TopicAliasMaximum = aliases
    return properties


@dataclass(frozen=True)
class BrokerLimits:
    """What a broker's CONNACK allows; `largest_packet` in bytes, None for no limit."""

    aliases: int = 0
    in_flight: int = MOST_IN_FLIGHT
    largest_packet: int | None = None

    @classmethod
    def of(cls, connack: object) -> BrokerLimits:
        return cls(
            min(getattr(connack, "TopicAliasMaximum", 0), MOST_ALIASES),
            min(getattr(connack, "ReceiveMaximum", MOST_IN_FLIGHT), MOST_IN_FLIGHT),
            getattr(connack, "MaximumPacketSize", None),
        )

    def fits(self, topic: str, payload: bytes) -> bool:
        """Whether a PUBLISH stays below the largest packet, by an upper bound of its length."""
        return self.largest_packet is None or len(payload) + 4 * len(topic) + _OVERHEAD <= self.largest_packet
