"""NFQUEUE by netlink (linux/netfilter/nfnetlink_queue.h): the packets of many queues over one socket.

Each link has its own queue, so the queue number of a packet identifies its link without a lookup. The kernel searches
for a packet from the oldest of its queue on, and so finds those of a link that keeps order at once. Only the first four
bytes of a packet are copied, which have its length, except for queues that need all of it.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
from pathlib import Path

from ..interfaces import NetError

NETLINK_NETFILTER = 12
SUBSYSTEM = 3 << 8
PACKET, VERDICT, CONFIG = SUBSYSTEM | 0, SUBSYSTEM | 1, SUBSYSTEM | 2
ERROR = 2
REQUEST, ACK = 1, 4
ATTRIBUTE_STAMP, ATTRIBUTE_PAYLOAD = 4, 10
CONFIG_COMMAND, CONFIG_PARAMS, CONFIG_LENGTH = 1, 2, 3
BIND = 1
COPY_PACKET = 2
VERDICT_HEADER, VERDICT_PAYLOAD = 2, 10
NF_DROP, NF_ACCEPT = 0, 1
HEAD_BYTES = 4
"""Version, type of service and total length of an IPv4 header."""
ALL_BYTES = 0xFFFF
QUEUE_PACKETS = 100_000
"""The most packets that the kernel holds for a link, in flight and waiting; it drops and counts those beyond."""
RECEIVE_BYTES = 64 << 20
SO_RCVBUFFORCE = 33
SO_TIMESTAMP = 29
_ID = struct.Struct(">I")
ATTRIBUTES_AT = 20
ID_AT, ID_BYTES = ATTRIBUTES_AT + 4, 4
"""A packet's id is the first of its attributes, the copied bytes are the last."""
SHORT_PAYLOAD = struct.pack("=HH", 4 + HEAD_BYTES, ATTRIBUTE_PAYLOAD)
"""The header of the copied bytes if only HEAD_BYTES are copied."""
STAMP = struct.Struct(">QQ")
STAMP_AT = 68
STAMP_HEAD = struct.pack("=HH", 4 + STAMP.size, ATTRIBUTE_STAMP)
"""A forwarded packet's time stamp is at STAMP_AT if STAMP_HEAD precedes it, which is so for packets without a mark."""
PACKET_KIND = struct.pack("=H", PACKET)
COUNTS_FILE = Path("/proc/net/netfilter/nfnetlink_queue")


def attribute(kind: int, payload: bytes) -> bytes:
    """Encode a netlink attribute, padded."""
    return struct.pack("=HH", 4 + len(payload), kind) + payload + bytes(-len(payload) % 4)


def message(kind: int, flags: int, queue: int, payload: bytes) -> bytes:
    """Encode a netfilter message about a queue."""
    header = struct.pack("=IHHII", 20 + len(payload), kind, flags, 0, 0)
    return header + struct.pack(">BBH", 0, 0, queue) + payload


def verdict_prefix(queue: int, accept: bool) -> bytes:
    """A verdict on a packet without its id, which must be appended; many verdicts may be sent together."""
    head = struct.pack("=HH", 12, VERDICT_HEADER) + _ID.pack(NF_ACCEPT if accept else NF_DROP)
    whole = message(VERDICT, REQUEST, queue, head + bytes(ID_BYTES))
    return whole[:-ID_BYTES]


def verdict_with(queue: int, packet: bytes, payload: bytes) -> bytes:
    """A verdict that accepts the packet with the id `packet`, with other content of the same length."""
    head = attribute(VERDICT_HEADER, _ID.pack(NF_ACCEPT) + packet)
    return message(VERDICT, REQUEST, queue, head + attribute(VERDICT_PAYLOAD, payload))


def value_of(data: bytes, kind: int) -> bytes:
    """The value of an attribute in a message of kind PACKET; empty without one."""
    at, end = ATTRIBUTES_AT, len(data)
    while at + 4 <= end:
        length, found = struct.unpack_from("=HH", data, at)
        if found == kind:
            return data[at + 4 : at + length]
        at += max(4, length + 3 & ~3)
    return b""


def payload_of(data: bytes) -> bytes:
    """The copied bytes, from the IPv4 header on."""
    return value_of(data, ATTRIBUTE_PAYLOAD)


def stamp_of(data: bytes) -> int | None:
    """When the packet arrived at this machine or container, in ns of the system's clock, exact to a microsecond."""
    value = value_of(data, ATTRIBUTE_STAMP)
    if len(value) != STAMP.size:
        return None
    seconds, microseconds = STAMP.unpack(value)
    return int(seconds * 1_000_000_000 + microseconds * 1000)


class Queues:
    """A socket bound to queues; `whole` are the queues of which whole packets are copied. Raises NetError."""

    def __init__(self, count: int, whole: frozenset[int]) -> None:
        try:
            self.socket = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_CLOEXEC, NETLINK_NETFILTER)
            self.socket.bind((0, 0))
            # While any socket asks for time stamps, the kernel gives one to every packet on arrival.
            self._stamping = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._stamping.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMP, 1)
        except OSError as error:
            raise NetError(f"netlink: {error.strerror}; expected a kernel with NFQUEUE") from error
        try:
            self.socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, RECEIVE_BYTES)
            for queue in range(count):
                self._configure(queue, attribute(CONFIG_COMMAND, struct.pack(">BBH", BIND, 0, socket.AF_INET)))
                copied = ALL_BYTES if queue in whole else HEAD_BYTES
                self._configure(queue, attribute(CONFIG_PARAMS, struct.pack(">IB", copied, COPY_PACKET)))
                self._configure(queue, attribute(CONFIG_LENGTH, _ID.pack(QUEUE_PACKETS)))
        except OSError as error:
            self.close()
            raise NetError(
                f"NFQUEUE: {os.strerror(error.errno or 0)}; expected CAP_NET_ADMIN and a kernel with NFQUEUE, "
                f"whose queues 0 to {count - 1} are free"
            ) from error
        self.socket.setblocking(False)

    def copy_whole(self, queue: int) -> None:
        """Copy a queue's packets completely from now on; those that already wait in the socket are still short."""
        params = attribute(CONFIG_PARAMS, struct.pack(">IB", ALL_BYTES, COPY_PACKET))
        self.socket.send(message(CONFIG, REQUEST, queue, params))

    def close(self) -> None:
        self.socket.close()
        self._stamping.close()

    def _configure(self, queue: int, payload: bytes) -> None:
        self.socket.send(message(CONFIG, REQUEST | ACK, queue, payload))
        while True:
            data = self.socket.recv(1 << 17)
            if struct.unpack_from("=H", data, 4)[0] == ERROR:
                (code,) = struct.unpack_from("=i", data, 16)
                if code:
                    raise OSError(-code, errno.errorcode.get(-code, ""))
                return


def read_drops(text: str) -> dict[int, int]:
    """By queue the packets that the kernel dropped because the queue or its socket was full, from COUNTS_FILE."""
    rows = [line.split() for line in text.splitlines()]
    return {int(row[0]): int(row[5]) + int(row[6]) for row in rows if len(row) >= 7}
