"""A UAV client's link to its autopilot, on UDP, and the sockets that write to it."""

from __future__ import annotations

import asyncio
import socket as sockets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from mqttxt.drone.mavlink.link import AutopilotLink
from mqttxt.drone.mavlink.signing import Signing
from mqttxt.drone.mavlink.sources import Source
from mqttxt.drone.mavlink.transports import AutopilotAddress
from tests.rigs.loopback import eventually, free_port


class LinkBench:
    """`heard` has the types of the messages that the link accepted, `refused` why it refused others."""

    def __init__(self, signing: Signing | None = None) -> None:
        self.heard: list[str] = []
        self.refused: list[str] = []
        self.port = free_port(sockets.SOCK_DGRAM)
        self.link = AutopilotLink(
            AutopilotAddress("udp", "127.0.0.1", self.port),
            1,
            lambda: self.heard.extend(message.get_type() for message in self.link.messages()),
            lambda found: self.refused.append(found.kind),
            signing,
        )
        self.sockets: list[sockets.socket] = []

    @asynccontextmanager
    async def open(self) -> AsyncIterator[LinkBench]:
        """Run the link while this is entered."""
        running = asyncio.create_task(self.link.run())
        await eventually(lambda: self.link._transport is not None, "it listens")
        yield self
        running.cancel()
        await asyncio.wait({running})
        for one in self.sockets:
            one.close()

    def socket(self) -> sockets.socket:
        made = sockets.socket(sockets.AF_INET, sockets.SOCK_DGRAM)
        made.connect(("127.0.0.1", self.port))
        made.setblocking(False)
        self.sockets.append(made)
        return made

    async def say(self, sender: sockets.socket, frame: bytes) -> None:
        """Send a frame, and wait until the link has taken or refused it."""
        before = len(self.heard) + len(self.refused)
        sender.send(frame)
        await eventually(lambda: len(self.heard) + len(self.refused) > before, "it was read")

    def write(self, message: Any, source: Source = Source.COMPANION) -> list[bytes]:
        """Write a message to the link; returns what each socket receives."""
        self.link.write(message, source)
        return [_received(one) for one in self.sockets]


def _received(one: sockets.socket) -> bytes:
    try:
        return one.recv(1000)
    except BlockingIOError:
        return b""
