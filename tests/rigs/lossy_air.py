"""A path for datagrams on loopback that loses, repeats, delays and reorders them, and can change the sender's port."""

from __future__ import annotations

import asyncio
from collections import Counter
from random import Random
from typing import Any, Self

from tests.rigs.loopback import free_port

UP, DOWN = "up", "down"
HEADERS = 28
"""Headers of IPv4 and UDP, in bytes."""

Address = tuple[Any, ...]


class LossyAir:
    """Passes datagrams on to `there` and back; `carried` has their bytes with headers, by direction.

    Probabilities are per datagram, delays in seconds. `seen` has each datagram with its direction, lost ones too.
    """

    def __init__(self, there: int, seed: int = 1) -> None:
        self.port = free_port()
        self.loses = self.repeats = self.reorders = 0.0
        self.delay_s = 0.0
        self.carried: Counter[str] = Counter()
        self.seen: list[tuple[str, bytes]] = []
        self._there = there
        self._rng = Random(seed)
        self._is_cut = False
        self._near: asyncio.DatagramTransport | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._far: dict[Address, asyncio.DatagramTransport] = {}

    @property
    def url(self) -> str:
        return f"mqtt-sn://127.0.0.1:{self.port}"

    async def start(self) -> Self:
        self._near = await _endpoint(self._from_client, ("127.0.0.1", self.port), None)
        return self

    def be_bad(self) -> None:
        """Become worse than the testbed's lossy profile."""
        self.loses, self.repeats, self.reorders, self.delay_s = 0.1, 0.05, 0.05, 0.02

    def cut(self) -> None:
        """Drop everything from now on, silently."""
        self._is_cut = True

    def go_on(self) -> None:
        self._is_cut = False

    def rebind(self) -> None:
        """Send the clients' datagrams from other ports from now on, as a NAT does that has forgotten them."""
        for transport in self._far.values():
            transport.close()
        self._far.clear()

    def close(self) -> None:
        self.rebind()
        if self._near is not None:
            self._near.close()

    def _from_client(self, data: bytes, client: Address) -> None:
        task = asyncio.ensure_future(self._up(data, client))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _up(self, data: bytes, client: Address) -> None:
        if client not in self._far:
            back = await _endpoint(lambda d, _: self._pass(DOWN, d, self._near, client), None, self._there)
            self._far.setdefault(client, back)
            if self._far[client] is not back:
                back.close()
        self._pass(UP, data, self._far[client], None)

    def _pass(self, way: str, data: bytes, out: asyncio.DatagramTransport | None, to: Address | None) -> None:
        self.seen.append((way, data))
        self.carried[way] += len(data) + HEADERS
        if self._is_cut or self._rng.random() < self.loses or out is None:
            return
        for _ in range(1 + (self._rng.random() < self.repeats)):
            late_s = self._rng.uniform(0, 0.5) if self._rng.random() < self.reorders else 0.0
            asyncio.get_running_loop().call_later(self.delay_s + late_s, _send, out, data, to)


class _Protocol(asyncio.DatagramProtocol):
    def __init__(self, received: Any) -> None:
        self.datagram_received = received


async def _endpoint(received: Any, here: Address | None, there: int | None) -> asyncio.DatagramTransport:
    remote = ("127.0.0.1", there) if there is not None else None
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(lambda: _Protocol(received), here, remote)
    return transport


def _send(out: asyncio.DatagramTransport, data: bytes, to: Address | None) -> None:
    if not out.is_closing():
        out.sendto(data, to)
