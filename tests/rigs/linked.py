"""A connection to a made-up broker, and a record of what its role receives."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Hashable
from contextlib import asynccontextmanager
from typing import Any

from mqttxt.core.address import BrokerAddress
from mqttxt.core.effects import Inbound, Publish, Subscribe, Will
from mqttxt.core.mqtt.link import MqttLink
from tests.rigs.mqtt_server import Server
from tests.rigs.processes import eventually

RECEIVE_MAXIMUM_2 = b"\x21\x00\x02"


WITH_WILL = b"\x04"


class Heard:
    """A runner that only records its events."""

    def __init__(self) -> None:
        self.connections = self.losses = 0
        self.messages: list[Inbound] = []
        self.subscribes: list[Subscribe] = []
        self.acknowledged: list[tuple[Hashable, int]] = []
        self.counted: list[str] = []
        self.fails_at: bytes | None = None
        self.on_received: Callable[[Inbound], None] = lambda message: None

    def connected(self, link: str) -> None:
        self.connections += 1

    def disconnected(self, link: str) -> None:
        self.losses += 1

    def received(self, link: str, message: Inbound) -> None:
        if message.payload == self.fails_at:
            raise RuntimeError("a role's mistake")
        self.messages.append(message)
        self.on_received(message)

    def subscribed(self, subscribe: Subscribe) -> None:
        self.subscribes.append(subscribe)

    def published(self, link: str, ref: Hashable, code: int) -> None:
        self.acknowledged.append((ref, code))

    def count(self, kind: str, detail: str) -> None:
        self.counted.append(kind)


@asynccontextmanager
async def linked(server: Server, scheme: str = "mqtt", **how: Any) -> AsyncIterator[tuple[MqttLink, Heard]]:
    """Yield a link that is connected to `server`, and the record of its events."""
    heard = Heard()
    address = BrokerAddress.parse(f"{scheme}://localhost:{server.port}")
    link = MqttLink("fog", address, "client-1", lambda: Will("drone1/reachable", b"down"), heard, **how)
    running = asyncio.create_task(link.run())
    try:
        await eventually(lambda: heard.connections == 1 or running.done(), "connected")
        yield link, heard
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def state(name: str, payload: bytes = b"\x82\x01\x02", qos: int = 0, ref: Hashable = None) -> Publish:
    return Publish("fog", f"drone1/state/{name}", payload, qos, ref=ref)
