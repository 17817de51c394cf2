"""The broker's side of MQTT 5 connections on loopback, as far as tests of clients need it."""

from __future__ import annotations

import asyncio
import ssl
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Self

SILENCE = -1
CONNECT, PUBLISH, PUBACK, SUBSCRIBE, PINGREQ, DISCONNECT = 1, 3, 4, 8, 12, 14
_DATA_SEGMENTS_IN = 152
"""Where tcpi_data_segs_in is in struct tcp_info (linux/tcp.h)."""


@dataclass(frozen=True)
class Packet:
    """A packet as received: type, flags, and everything after the fixed header."""

    kind: int
    flags: int
    body: bytes

    @property
    def qos(self) -> int:
        return (self.flags >> 1) & 3

    def publish(self) -> tuple[str, dict[int, int], bytes, int]:
        """Topic, the numbers among its properties by identifier, payload and packet id (0 at QoS 0)."""
        length = int.from_bytes(self.body[:2], "big")
        topic, rest = self.body[2 : 2 + length].decode(), self.body[2 + length :]
        mid = 0
        if self.qos:
            mid, rest = int.from_bytes(rest[:2], "big"), rest[2:]
        end = 1 + rest[0]
        return topic, numbers(rest[1:end]), rest[end:], mid


def numbers(properties: bytes) -> dict[int, int]:
    """Properties that are numbers (2 and 4 bytes), by identifier."""
    sizes = {0x02: 4, 0x11: 4, 0x21: 2, 0x22: 2, 0x23: 2, 0x27: 4}
    found = {}
    while properties:
        identifier, size = properties[0], sizes[properties[0]]
        found[identifier] = int.from_bytes(properties[1 : 1 + size], "big")
        properties = properties[1 + size :]
    return found


def publish(topic: str, payload: bytes, qos: int = 0, mid: int = 0, properties: bytes = b"") -> bytes:
    """The bytes of a PUBLISH to the client."""
    name = struct.pack("!H", len(topic)) + topic.encode() + (struct.pack("!H", mid) if qos else b"")
    body = name + variable_length(len(properties)) + properties + payload
    return bytes([0x30 | qos << 1]) + variable_length(len(body)) + body


async def read_packet(reader: asyncio.StreamReader) -> Packet:
    """Read the next packet. Raises IncompleteReadError at the end of the connection."""
    (first,) = await reader.readexactly(1)
    length = shift = 0
    while True:
        (digit,) = await reader.readexactly(1)
        length |= (digit & 127) << shift
        shift += 7
        if digit < 128:
            break
    return Packet(first >> 4, first & 15, await reader.readexactly(length))


def encoded(packet: Packet) -> bytes:
    """A packet's bytes."""
    return bytes([packet.kind << 4 | packet.flags]) + variable_length(len(packet.body)) + packet.body


def variable_length(length: int) -> bytes:
    """A length as MQTT writes it (1.5.5)."""
    out = bytearray()
    while True:
        length, digit = divmod(length, 128)
        out.append(digit | (0x80 if length else 0))
        if not length:
            return bytes(out)


class Session:
    """One connection of a client, after its CONNACK."""

    def __init__(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, acknowledges: bool, granted: Iterator[int]
    ) -> None:
        self.packets: list[Packet] = []
        self.ended = self.was_reset = False
        self.reads = asyncio.Event()
        self.reads.set()
        self._reader = reader
        self._writer = writer
        self._acknowledges = acknowledges
        self._granted = granted

    def of(self, kind: int) -> list[Packet]:
        return [packet for packet in self.packets if packet.kind == kind]

    def send(self, data: bytes) -> None:
        self._writer.write(data)

    def acknowledge(self, mid: int, code: int = 0) -> None:
        """Send the PUBACK of a message, with a reason code."""
        self.send(b"\x40\x03" + struct.pack("!HB", mid, code))

    def end(self) -> None:
        self._writer.close()

    def segments(self) -> int:
        """TCP segments with data received so far, as the kernel counts them."""
        info = self._writer.get_extra_info("socket").getsockopt(6, 11, 256)  # IPPROTO_TCP, TCP_INFO
        return int(struct.unpack_from("=I", info, _DATA_SEGMENTS_IN)[0])

    async def read(self) -> Packet:
        """Read and record the next packet. Raises IncompleteReadError at the end of the connection."""
        packet = await read_packet(self._reader)
        self.packets.append(packet)
        return packet

    async def serve(self) -> None:
        try:
            while True:
                await self.reads.wait()
                packet = await self.read()
                if packet.kind == SUBSCRIBE:
                    code = next(self._granted, 1)
                    if code != SILENCE:
                        self.send(b"\x90\x04" + packet.body[:2] + b"\0" + bytes([code]))
                if packet.kind == PUBLISH and packet.qos and self._acknowledges:
                    self.acknowledge(packet.publish()[3])
        except (asyncio.IncompleteReadError, ConnectionError) as end:
            self.ended, self.was_reset = True, isinstance(end, ConnectionError)
        finally:
            self._writer.close()


class Server:
    """Accepts connections on loopback; `connack` are the CONNACK's properties, `code` its reason code.

    `granted` are the reason codes of the first SUBACKs, across all sessions; SILENCE leaves one out.
    """

    def __init__(
        self,
        connack: bytes = b"",
        code: int = 0,
        acknowledges: bool = True,
        tls: ssl.SSLContext | None = None,
        granted: Iterable[int] = (),
        port: int = 0,
    ) -> None:
        self._wanted_port = port
        self._granted = iter(granted)
        self.answers = asyncio.Event()
        """Whether each CONNECT gets its CONNACK."""
        self.answers.set()
        self.sessions: list[Session] = []
        self._connack = b"\0" + bytes([code]) + variable_length(len(connack)) + connack
        self._acknowledges = acknowledges
        self._tls = tls
        self._server: asyncio.Server | None = None
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def port(self) -> int:
        assert self._server is not None
        return int(self._server.sockets[0].getsockname()[1])

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self._wanted_port, ssl=self._tls)
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        for session in self.sessions:
            session.end()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def make_session(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> Session:
        return Session(reader, writer, self._acknowledges, self._granted)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.append(task)
        session = self.make_session(reader, writer)
        await session.read()
        await self.answers.wait()
        session.send(b"\x20" + variable_length(len(self._connack)) + self._connack)
        self.sessions.append(session)
        await session.serve()
