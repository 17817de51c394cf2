"""A TCP link on loopback that can be cut, hold back one direction, or delay both; it counts its bytes."""

from __future__ import annotations

import asyncio
import random
import socket
import struct
from collections import Counter

from mqttxt.core.address import BrokerAddress
from mqttxt_conformance.relay import DOWN, MOST_BYTES, UP, Relay
from tests.rigs.loopback import free_port

HEADERS = 14 + 20 + 32
"""The headers of an Ethernet frame, in bytes: Ethernet's, IP's, and TCP's with timestamps."""
_TCP_INFO_BYTES = 144
_COUNTS = struct.Struct("=QQII")
"""Of Linux's tcp_info: bytes acknowledged and received, segments out and in."""
_COUNTS_AT = 120


class FlakyLink(Relay):
    """A relay to the port `there`; `carried` counts the bytes of each direction.

    Data arrives `one_way_s` later, plus up to `jitter_s` at random.
    """

    def __init__(self, there: int) -> None:
        super().__init__(BrokerAddress("127.0.0.1", there), free_port())
        self.carried: Counter[str] = Counter()
        self.one_way_s = self.jitter_s = 0.0
        self._passes = {UP: asyncio.Event(), DOWN: asyncio.Event()}
        self._clients: set[asyncio.StreamWriter] = set()
        self.go_on()

    @property
    def port(self) -> int:
        return self.address.port

    @property
    def url(self) -> str:
        return str(self.address)

    def frames(self) -> tuple[int, int]:
        """The frames of the client's present connections, bare acknowledgements included, and their bytes."""
        counts = [_counts(writer) for writer in self._clients]
        segments = sum(out + into for _, _, out, into in counts)
        return segments, segments * HEADERS + sum(sent + received for sent, received, _, _ in counts)

    def stall(self, *ways: str) -> None:
        """Hold back these directions, by default both, without closing any connection."""
        for way in ways or (UP, DOWN):
            self._passes[way].clear()

    def go_on(self) -> None:
        """Let everything pass again, held data first."""
        super().go_on()
        for passes in self._passes.values():
            passes.set()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._clients.add(writer)
        try:
            await super().serve(reader, writer)
        finally:
            self._clients.discard(writer)

    async def carry(self, way: str, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        """Carry one direction in order; the connection's end follows all data under way."""
        loop, under_way = asyncio.get_running_loop(), asyncio.Queue[tuple[float, bytes]]()
        async with asyncio.TaskGroup() as both:
            both.create_task(self._deliver(way, under_way, sink))
            data = None
            while data != b"":
                try:
                    data = await source.read(MOST_BYTES)
                except ConnectionError:
                    data = b""
                self.carried[way] += len(data)
                under_way.put_nowait((loop.time() + self.one_way_s + random.uniform(0, self.jitter_s), data))

    async def _deliver(
        self, way: str, under_way: asyncio.Queue[tuple[float, bytes]], sink: asyncio.StreamWriter
    ) -> None:
        loop, data = asyncio.get_running_loop(), None
        while data != b"":
            due_s, data = await under_way.get()
            await asyncio.sleep(due_s - loop.time())
            await self._passes[way].wait()
            sink.write(data)
        raise ConnectionResetError("closed")


def _counts(writer: asyncio.StreamWriter) -> tuple[int, int, int, int]:
    info = writer.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO_BYTES)
    sent, received, out, into = _COUNTS.unpack_from(info, _COUNTS_AT)
    return sent, received, out, into
