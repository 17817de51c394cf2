"""The environment of an activator with a gateway for datagrams: the kit is drone 1 and its other clients."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import AsyncIterator

from mqttxt.core.clock import SessionClock
from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import Presence
from mqttxt.protocol.topics import FogSide

from . import datagrams as wire
from .activator_kit import PATIENCE_S, ActivatorKit
from .datagrams import (
    CLEAN,
    NORMAL,
    PREDEFINED,
    QOS_1,
    RETAIN,
    TOGETHER,
    WILL,
    Address,
    AirLine,
    Packet,
    ids_of,
)
from .fake_drone import FakeDrone
from .registry import Broken, expect
from .tap import Heard

KEEPALIVE_S = 15


class Client(AirLine):
    """A UAV client of the kit; it uses the topic ids of `drone`."""

    def __init__(self, root: str, drone: int, clock: SessionClock) -> None:
        super().__init__(ids_of(root, drone), clock)
        self.topics, self.drone = FogSide(root), drone
        self.name = f"conformance-{secrets.token_hex(4)}"

    async def reach(self, gateway: Address) -> None:
        """Open a UDP port of its own; raises ConfigurationError."""
        await self.open("--air-sn", remote=gateway)

    async def ask(self, kind: int, answer: int, *numbers: int, rest: bytes = b"") -> Packet:
        """Repeat a packet every second until its answer arrives; raises Broken without one."""
        mark = len(self.came)
        for _ in range(round(PATIENCE_S)):
            self.send(kind, *numbers, rest=rest)
            if found := await self.until(lambda: self.packets(answer, mark), 1.0):
                first: Packet = found[0]
                return first
        raise Broken(f"no answer to packet kind 0x{kind:02x} within {PATIENCE_S:g} s")

    async def connect(self, will: Presence | None = None, keepalive_s: int = KEEPALIVE_S) -> int:
        """Connect; returns CONNACK's return code."""
        flags = CLEAN | WILL * (will is not None)
        answer = wire.WILLTOPICREQ if will is not None else wire.CONNACK
        found = await self.ask(wire.CONNECT, answer, flags, 1, keepalive_s, rest=self.name.encode())
        if will is not None:
            topic = self.topics.reachable(self.drone).encode()
            await self.ask(wire.WILLTOPIC, wire.WILLMSGREQ, QOS_1 | RETAIN, rest=topic)
            found = await self.ask(wire.WILLMSG, wire.CONNACK, rest=encode(will))
        return found.code

    async def subscribe(self, topic: int | str, flags: int = 0) -> Packet:
        """Subscribe; returns the SUBACK."""
        rest = topic.to_bytes(2, "big") if isinstance(topic, int) else topic.encode()
        kind = PREDEFINED if isinstance(topic, int) else NORMAL
        return await self.ask(wire.SUBSCRIBE, wire.SUBACK, flags | QOS_1 | kind, self.next_id, rest=rest)

    def on_packet(self, packet: Packet) -> None:
        if packet.kind == wire.PINGREQ and self.answers(packet):
            self.send(wire.PINGRESP)
        else:
            super().on_packet(packet)

    async def close(self) -> None:
        """Send DISCONNECT once and close the port."""
        self.send(wire.DISCONNECT)
        await super().close()

    def id_of(self, topic: str) -> int:
        return next(number for number, name in self.ids.items() if name == topic)


class AirKit(ActivatorKit):
    """A kit whose drone 1 connects by datagrams; `fog` listens at the fog's broker, and publishes for the gateway."""

    gateway: Address = ()

    @contextlib.asynccontextmanager
    async def client(self, drone: int = 2) -> AsyncIterator[Client]:
        """Another client, on a UDP port of its own, which is closed at the end."""
        made = await self._opened(drone)
        try:
            yield made
        finally:
            await made.close()

    async def _opened(self, drone: int) -> Client:
        made = Client(self.fog_side.root, drone, self.clock)
        await made.reach(self.gateway)
        return made

    async def meet_all(self) -> None:
        """Wait for the activator, then add drone 1; raises Broken."""
        await self.meet()
        await self.add_drones()

    async def add_drones(self) -> None:
        """Connect drone 1 by datagrams and register the station; raises Broken."""
        self.air = await self._opened(1)
        one = FakeDrone(1, self.fog_side, self.air)
        self.drones = {1: one}
        code = await self.air.connect(Presence(session=one.session, up=False))
        expect(code == 0, f"CONNACK with return code {code}")
        self.air.on_heard = one.on_heard
        await self.air.subscribe(TOGETHER)
        for topic, flags in ((self.fog_side.init_connect(1), 0), (self.fog_side.commands(1), RETAIN)):
            await self.air.subscribe(self.air.id_of(topic), flags)
        one.born()
        self.station.register()
        held = {"up": True, "holder": self.station.name}
        await self.cloud.until(lambda: held.items() <= self.record(1).items(), PATIENCE_S)

    def at_broker(self, topic: str, mark: int = 0) -> list[Heard]:
        return self.fog.since(mark, topic)

    async def close(self) -> None:
        if hasattr(self, "air"):
            await self.air.close()
        await super().close()
