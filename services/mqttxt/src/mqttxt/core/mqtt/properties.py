"""The MQTT 5 properties of CONNECT, and the limits in a broker's CONNACK."""

from __future__ import annotations

from dataclasses import dataclass

from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

LARGEST_PACKET = 65_536
"""Bytes; announced to the broker, which must not send longer packets (MQTT 5.0, 3.1.2.11.4)."""
MOST_ALIASES = 4096
MOST_RECEIVED = 1000
"""Receive Maximum: how many QoS 1 publishes the broker may send without our acknowledgement."""
MOST_IN_FLIGHT = 100
"""How many QoS 1 publishes we send without the broker's acknowledgement, if it allows as many."""
_OVERHEAD = 32
"""Upper bound of a PUBLISH's bytes besides topic and payload: header 5, lengths 3, packet id 2, alias 3, expiry 5."""


def connect_properties(session_expiry_s: int, aliases: int) -> Properties:
    """The properties of a CONNECT: how long the session outlives the connection, and what the broker may send to us."""
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.SessionExpiryInterval = session_expiry_s
    properties.MaximumPacketSize = LARGEST_PACKET
    properties.ReceiveMaximum = MOST_RECEIVED
    if aliases:
        properties.TopicAliasMaximum = aliases
    return properties


@dataclass(frozen=True)
class BrokerLimits:
    """The limits in a broker's CONNACK; `largest_packet` in bytes, None for no limit."""

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
        """Whether a PUBLISH stays within the largest packet, by an upper bound of its length."""
        return self.largest_packet is None or len(payload) + 4 * len(topic) + _OVERHEAD <= self.largest_packet
