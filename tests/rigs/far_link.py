"""A TCP connection over a slow link, on loopback: every byte arrives late, and a lost one after its retransmission."""

from __future__ import annotations

import asyncio
import random
import threading
from typing import Self

from tests.rigs.processes import free_port, listens, wait_until
from tests.simulation.far import AGAIN, FarLink

MOST_BYTES = 1448
"""The payload of a TCP segment on Ethernet, which is the unit of loss."""


class Far:
    """Passes connections to `port` on to another port of this machine, with the delay and loss of `link`."""

    def __init__(self, there: int, link: FarLink) -> None:
        self.port = free_port()
        self._there = there
        self._link = link
        self._rng = random.Random(7)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> Self:
        self._thread.start()
        wait_until(lambda: listens(self.port), "the far link")
        return self

    def close(self) -> None:
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
        self._loop.close()

    def _run(self) -> None:
        self._loop.run_until_complete(asyncio.start_server(self._serve, "127.0.0.1", self.port))
        self._loop.run_forever()
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
            self._loop.run_until_complete(asyncio.gather(task, return_exceptions=True))

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, to_there = await asyncio.open_connection("127.0.0.1", self._there)
        await asyncio.gather(self._carry(reader, to_there), self._carry(there, writer))

    async def _carry(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        """Carry one direction, in order."""
        loop, under_way, arrives = self._loop, asyncio.Queue[tuple[float, bytes]](), 0.0
        delivering = asyncio.create_task(_deliver(under_way, sink))
        try:
            while data := await source.read(MOST_BYTES):
                late_s = self._link.one_way_ms / 1000
                while self._rng.random() < self._link.loss:
                    late_s += AGAIN * self._link.one_way_ms / 1000
                arrives = max(arrives, loop.time() + late_s)
                under_way.put_nowait((arrives, data))
        except ConnectionError:
            pass
        finally:
            under_way.put_nowait((arrives, b""))
            await delivering


async def _deliver(under_way: asyncio.Queue[tuple[float, bytes]], sink: asyncio.StreamWriter) -> None:
    while True:
        arrives, data = await under_way.get()
        await asyncio.sleep(arrives - asyncio.get_running_loop().time())
        if not data:
            sink.close()
            return
        sink.write(data)
