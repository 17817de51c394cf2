"""TCP links to brokers on this machine that the kit can cut; subclasses may hold back or delay their bytes."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace
from typing import Self

from mqttxt.core.address import BrokerAddress

from .tap import Tap, clear_retained

UP, DOWN = "up", "down"
"""The directions: from the client, and to it."""
MOST_BYTES = 65_536


class Relay:
    """Passes TCP connections on to `broker`; after `start`, clients connect to `address`."""

    def __init__(self, broker: BrokerAddress, port: int = 0) -> None:
        self.address = replace(broker, port=port)
        self._broker = broker
        self._server: asyncio.Server | None = None
        self._serving: set[asyncio.Task[None]] = set()
        self._is_cut = False

    async def start(self) -> Self:
        self._server = await asyncio.start_server(self._accept, self.address.host, self.address.port)
        self.address = replace(self.address, port=self._server.sockets[0].getsockname()[1])
        return self

    def cut(self) -> None:
        """End every connection, and close new ones at once."""
        self._is_cut = True
        for task in self._serving:
            task.cancel()

    def go_on(self) -> None:
        """Pass connections on again."""
        self._is_cut = False

    async def close(self) -> None:
        self.cut()
        if self._server is not None:
            self._server.close()
        await asyncio.gather(*self._serving, return_exceptions=True)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.create_task(self.serve(reader, writer))
        self._serving.add(task)
        task.add_done_callback(self._serving.discard)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a client's connection until either side ends it."""
        writers = [writer]
        try:
            if self._is_cut:
                return
            there, to_there = await asyncio.open_connection(self._broker.host, self._broker.port)
            writers.append(to_there)
            async with asyncio.TaskGroup() as both:
                both.create_task(self.carry(UP, reader, to_there))
                both.create_task(self.carry(DOWN, there, writer))
        except* OSError:
            pass
        finally:
            for each in writers:
                each.transport.abort()

    async def carry(self, way: str, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        """Carry the bytes of one direction; raises ConnectionResetError at the connection's end."""
        while data := await source.read(MOST_BYTES):
            sink.write(data)
            await sink.drain()
        raise ConnectionResetError("closed")


@dataclass(frozen=True)
class Two:
    """A second broker: the kit's connection to it, the drone's own there, and the relays to both brokers."""

    tap: Tap
    twin: Tap
    relays: tuple[Relay, Relay]

    async def close(self, own_topic: str) -> None:
        await clear_retained(self.twin, [own_topic])
        for tap in {self.tap, self.twin}:
            await tap.close()
        for relay in self.relays:
            await relay.close()
