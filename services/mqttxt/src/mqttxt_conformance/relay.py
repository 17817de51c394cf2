"""TCP links of the kit's to two brokers on this machine, which it can cut under the implementation."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace

from mqttxt.core.address import BrokerAddress

from .tap import Tap, clear_retained

MOST_BYTES = 65_536


class Relay:
    """Passes connections on to `broker`; `address` is where the implementation connects to."""

    def __init__(self, broker: BrokerAddress) -> None:
        self._broker = broker
        self._server: asyncio.Server | None = None
        self._serving: set[asyncio.Task[None]] = set()
        self._is_cut = False
        self.address = broker

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._accept, self._broker.host)
        self.address = replace(self._broker, port=self._server.sockets[0].getsockname()[1])

    def cut(self) -> None:
        """Every connection ends, and no other comes about."""
        self._is_cut = True
        for task in self._serving:
            task.cancel()

    def mend(self) -> None:
        self._is_cut = False

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
        try:
            if self._is_cut:
                return
            there, to_there = await asyncio.open_connection(self._broker.host, self._broker.port)
            writers.append(to_there)
            async with asyncio.TaskGroup() as both:
                both.create_task(_carry(reader, to_there))
                both.create_task(_carry(there, writer))
        except* OSError:
            pass
        finally:
            for each in writers:
                each.transport.abort()


async def _carry(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    while data := await source.read(MOST_BYTES):
        sink.write(data)
        await sink.drain()
    raise ConnectionResetError("closed")


@dataclass(frozen=True)
class Two:
    """A second broker: the kit's connection to it, the drone's own there, and the links of both that it can cut."""

    tap: Tap
    twin: Tap
    relays: tuple[Relay, Relay]

    async def close(self, own_topic: str) -> None:
        await clear_retained(self.twin, [own_topic])
        for tap in {self.tap, self.twin}:
            await tap.close()
        for relay in self.relays:
            await relay.close()
