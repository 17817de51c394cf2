"""Ethernet, IPv4, TCP and UDP headers of a capture, read for all frames at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fly.pcap import Bytes, CapturedFrames, Flags, Ints, Words, big_endian, windows

PROTOCOLS = ("other", "arp", "ipv6", "icmp", "igmp", "tcp", "udp", "mqtt", "mavlink", "mqttsn")
"""The protocols of frames; the codes in `Headers.protocol` are indexes into this."""
OTHER, ARP, IPV6, ICMP, IGMP, TCP, UDP, MQTT, MAVLINK, MQTT_SN = range(len(PROTOCOLS))
MQTT_PORT, MQTTS_PORT = 1883, 8883
"""The ports of brokers without and with TLS. TCP on either is MQTT here, UDP on the first is MQTT-SN."""
ETHERNET = 14
_IPV4, _ETHER_TYPES = 0x0800, {0x0806: ARP, 0x86DD: IPV6}
_IP_PROTOCOLS = {1: ICMP, 2: IGMP, 6: TCP, 17: UDP}
_LEAST_IP, _LEAST_TCP, _UDP_HEADER = 20, 20, 8
_ROOM = np.array([(1 << 8 * room) - 1 for room in range(9)], dtype=np.uint64)
_MIX = np.uint64(0x9E3779B97F4A7C15)
_FOLD = np.uint64(29)


@dataclass(frozen=True)
class Headers:
    """An array per field, with an entry per frame. Addresses are IPv4 as numbers, -1 for frames that are not IPv4.

    `ethernet` (padding included), `ip` and `transport` are bytes of headers; the content of TCP, UDP or IP is
    `data[body:body_end]`. `sequence` and `flags` are TCP's. `key` distinguishes the frames of a link, and is the same
    at both ends of the link if the content is unchanged: it covers neither the TTL nor checksums.
    """

    protocol: Ints
    source_mac: Ints
    source: Ints
    destination: Ints
    source_port: Ints
    destination_port: Ints
    ethernet: Ints
    ip: Ints
    transport: Ints
    body: Ints
    body_end: Ints
    sequence: Ints
    flags: Ints
    key: Words


def read_headers(capture: CapturedFrames) -> Headers:
    """Read the headers of every frame; a frame that is not IPv4 counts as Ethernet in full."""
    rows = windows(capture.data, ETHERNET + _LEAST_IP, capture.starts)
    ether_type = big_endian(rows, 12, 2)
    is_ip = (ether_type == _IPV4) & (capture.lengths >= ETHERNET + _LEAST_IP)
    ip = np.where(is_ip, (rows[:, ETHERNET].astype(np.int64) & 0x0F) * 4, 0)
    total = np.where(is_ip, big_endian(rows, 16, 2), 0)
    at = capture.starts + ETHERNET + ip
    end = capture.starts + np.minimum(ETHERNET + total, capture.lengths)
    first_fragment = (big_endian(rows, 20, 2) & 0x1FFF) == 0
    protocol = _protocols(ether_type, rows[:, 23], is_ip, first_fragment, at, capture)
    is_tcp, is_udp = protocol == TCP, protocol == UDP
    behind = windows(capture.data, _LEAST_TCP, at)
    transport = np.where(is_tcp, (behind[:, 12].astype(np.int64) >> 4) * 4, np.where(is_udp, _UDP_HEADER, 0))
    has_ports = is_tcp | is_udp
    source_port = np.where(has_ports, big_endian(behind, 0, 2), 0)
    destination_port = np.where(has_ports, big_endian(behind, 2, 2), 0)
    for port in (MQTT_PORT, MQTTS_PORT):
        protocol[is_tcp & ((source_port == port) | (destination_port == port))] = MQTT
    protocol[is_udp & ((source_port == MQTT_PORT) | (destination_port == MQTT_PORT))] = MQTT_SN
    body = at + transport
    body_end = np.maximum(body, end)
    source = np.where(is_ip, big_endian(rows, 26, 4), -1)
    destination = np.where(is_ip, big_endian(rows, 30, 4), -1)
    ethernet = np.where(is_ip, ETHERNET + np.maximum(0, capture.sizes - ETHERNET - total), capture.sizes)
    numbers = [
        source << 32 | destination,
        big_endian(rows, 18, 2) << 48 | total << 32 | source_port << 16 | destination_port,
        np.where(is_tcp, big_endian(behind, 4, 8), 0),
    ]
    key = _mixed([*(number.astype(np.uint64) for number in numbers), *_ends(capture.data, body, body_end)])
    return Headers(
        protocol=protocol,
        source_mac=big_endian(rows, 6, 6),
        source=source,
        destination=destination,
        source_port=source_port,
        destination_port=destination_port,
        ethernet=ethernet,
        ip=ip,
        transport=transport,
        body=body,
        body_end=body_end,
        sequence=big_endian(behind, 4, 4),
        flags=behind[:, 13].astype(np.int64),
        key=key,
    )


def _protocols(ether_type: Ints, number: Bytes, is_ip: Flags, first: Flags, at: Ints, capture: CapturedFrames) -> Ints:
    protocol = np.full(len(ether_type), OTHER, dtype=np.int64)
    for value, name in _ETHER_TYPES.items():
        protocol[~is_ip & (ether_type == value)] = name
    for value, name in _IP_PROTOCOLS.items():
        protocol[is_ip & first & (number == value)] = name
    room = capture.starts + capture.lengths - at
    protocol[(protocol == TCP) & (room < _LEAST_TCP) | (protocol == UDP) & (room < _UDP_HEADER)] = OTHER
    return protocol


def _ends(data: Bytes, body: Ints, body_end: Ints) -> list[Words]:
    """The first 16 bytes of a frame's content, the last eight, which have a MAVLink message's CRC, and the sum of all,
    which shows a flipped bit."""
    length = body_end - body
    last = np.maximum(body, body_end - 8)
    return [
        _word(data, body, length),
        _word(data, body + 8, length - 8),
        _word(data, last, length),
        _sum(data, body, length),
    ]


def _sum(data: Bytes, body: Ints, length: Ints) -> Words:
    if not len(body):
        return np.empty(0, dtype=np.uint64)
    edges = np.stack([body, body + length], axis=1).ravel()
    sums = np.add.reduceat(data, edges, dtype=np.uint32)[::2]  # for two equal edges reduceat gives one byte
    return np.where(length > 0, sums, 0).astype(np.uint64)


def _word(data: Bytes, at: Ints, room: Ints) -> Words:
    """Eight bytes from each position on; those beyond `room` are 0."""
    found: Words = np.ascontiguousarray(windows(data, 8, at)).view("<u8").ravel()
    return found & _ROOM[np.clip(room, 0, 8)]


def _mixed(words: list[Words]) -> Words:
    """A hash of 64 bits: in one of 10^8 attempts two frames of a link would have the same one."""
    key = np.zeros(len(words[0]), dtype=np.uint64)
    for word in words:
        key = (key ^ word) * _MIX
        key ^= key >> _FOLD
    return key
