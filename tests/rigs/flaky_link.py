"""A TCP link on loopback that can be cut, or hold back what goes one way; it counts what it carries."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections import Counter
from typing import Self

from tests.rigs.loopback import free_port

UP, DOWN = "up", "down"
HEADERS = 14 + 20 + 32
"""Of a frame on Ethernet: Ethernet's, IP's, and TCP's with time stamps, in bytes."""
_TCP_INFO_BYTES = 144
_COUNTS = struct.Struct("=QQII")
"""Of Linux's tcp_info: bytes acknowledged and received, segments out and in."""
_COUNTS_AT = 120


class FlakyLink:
    """Passes connections to `there` on; `carried` has the bytes of each direction (up: of the client)."""

    def __init__(self, there: int, host: str = "127.0.0.1") -> None:
        self.port = free_port()
        self.host = host
        self.carried: Counter[str] = Counter()
        self.one_way_s = 0.0
        self._there = there
        self._is_cut = False
        self._passes = {UP: asyncio.Event(), DOWN: asyncio.Event()}
        self._server: asyncio.Server | None = None
        self._serving: set[asyncio.Task[None]] = set()
        self._clients: set[asyncio.StreamWriter] = set()
        self.go_on()

    @property
    def url(self) -> str:
        return f"mqtt://{self.host}:{self.port}"

    async def start(self) -> Self:
        self._server = await asyncio.start_server(self._accept, self.host, self.port)
        return self

    def frames(self) -> tuple[int, int]:
        """How many frames the client's connections of now have had, bare acknowledgements too, and their bytes."""
        counts = [_counts(writer) for writer in self._clients]
        segments = sum(out + into for _, _, out, into in counts)
        return segments, segments * HEADERS + sum(sent + received for sent, received, _, _ in counts)

    def cut(self) -> None:
        """Every connection ends, and no other comes about."""
        self._is_cut = True
        for task in self._serving:
            task.cancel()

    def hold(self, *ways: str) -> None:
        """Nothing passes any more in these directions, and nobody is told."""
        for way in ways or (UP, DOWN):
            self._passes[way].clear()

    def go_on(self) -> None:
        """What was held passes, and connections come about."""
        self._is_cut = False
        for passes in self._passes.values():
            passes.set()

    async def close(self) -> None:
        self.cut()
        if self._server is not None:
            self._server.close()
        await asyncio.gather(*self._serving, return_exceptions=True)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.create_task(self._serve(reader, writer))
        self._serving.add(task)
        task.add_done_callback(self._serving.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers = [writer]
        self._clients.add(writer)
        try:
            if self._is_cut:
                return
            there, to_there = await asyncio.open_connection("127.0.0.1", self._there)
            writers.append(to_there)
            async with asyncio.TaskGroup() as both:
                both.create_task(self._carry(UP, reader, to_there))
                both.create_task(self._carry(DOWN, there, writer))
        except* (ConnectionError, OSError):
            pass
        finally:
            self._clients.discard(writer)
            for each in writers:
                each.transport.abort()

    async def _carry(self, way: str, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        """One direction: nothing overtakes. Ends the connection where one side does."""
        loop, under_way = asyncio.get_running_loop(), asyncio.Queue[tuple[float, bytes]]()
        delivering = asyncio.create_task(self._deliver(way, under_way, sink))
        try:
            while data := await source.read(65_536):
                self.carried[way] += len(data)
                under_way.put_nowait((loop.time() + self.one_way_s, data))
            raise ConnectionResetError("closed")
        finally:
            delivering.cancel()

    async def _deliver(
        self, way: str, under_way: asyncio.Queue[tuple[float, bytes]], sink: asyncio.StreamWriter
    ) -> None:
        loop = asyncio.get_running_loop()
        while True:
            due_s, data = await under_way.get()
            await asyncio.sleep(due_s - loop.time())
            await self._passes[way].wait()
            sink.write(data)


def _counts(writer: asyncio.StreamWriter) -> tuple[int, int, int, int]:
    info = writer.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO_BYTES)
    sent, received, out, into = _COUNTS.unpack_from(info, _COUNTS_AT)
    return sent, received, out, into
