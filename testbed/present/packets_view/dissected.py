"""Single frames of an attempt's captures, dissected by scapy with the testbed's layers."""

from __future__ import annotations

from pathlib import Path

from scapy.layers.inet import TCP, UDP
from scapy.packet import Packet, Raw
from scapy.utils import PcapReader

from ...numbers.dissect.mavlink import MAVLink
from ...numbers.dissect.mqtt5 import MQTT
from ...numbers.dissect.mqtt5_codes import TYPES

_RECORD_HEADER = 16


def read_frame(pcap: Path, offset: int) -> Packet:
    """Read the frame whose first byte is at `offset` in a capture file."""
    with PcapReader(str(pcap)) as reader:
        reader.f.seek(offset - _RECORD_HEADER)
        return reader.read_packet()


def dissect(packet: Packet, protocol: str, kinds: list[str]) -> Packet:
    """Turn a frame's messages into layers, whatever its ports are.

    `kinds` are the messages that begin in it by the packets table. A segment that begins within an MQTT packet is left
    as it is, because its first bytes are not those of a packet.
    """
    for protocol_of, transport, layer in (("mavlink", UDP, MAVLink), ("mqtt", TCP, MQTT)):
        if protocol != protocol_of or transport not in packet or not isinstance(packet[transport].payload, Raw):
            continue
        body = layer(packet[transport].payload.load)
        found = [TYPES[it.type].lower() for it in body.iterpayloads() if isinstance(it, MQTT)]
        if layer is MAVLink or (found and found == kinds[: len(found)]):
            packet[transport].remove_payload()
            packet[transport].add_payload(body)
    return packet


def mavlink_frames(packet: Packet) -> list[MAVLink]:
    """The MAVLink frames of a dissected datagram, in order."""
    return [layer for layer in packet.iterpayloads() if isinstance(layer, MAVLink)]
