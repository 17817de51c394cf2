"""The environment of a UAV client over datagrams: the kit is the gateway, the activator behind it and the autopilot."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from mqttxt.core.clock import SessionClock
from mqttxt.protocol.messages import CommandMessage
from mqttxt.protocol.topics import FogSide

from . import datagrams as wire
from .autopilot import ARM, Autopilot
from .datagrams import (
    CONNACK,
    CONNECT,
    DISCONNECT,
    PINGRESP,
    PREDEFINED,
    QOS_1,
    SUBACK,
    UNSUBACK,
    WILL,
    WILLMSGREQ,
    WILLTOPICREQ,
    AirLine,
    Packet,
)
from .registry import expect
from .subject import Subject
from .uav_kit import QUIET_S, UavKit


class Gateway(AirLine):
    """The kit's gateway; its client is the sender of the newest CONNECT."""

    def on_packet(self, packet: Packet) -> None:
        if packet.kind == CONNECT:
            self.peer = packet.sender
            self.forget()
        if packet.sender != self.peer or not self.answers(packet):
            return
        code = self.codes.get(packet.kind, 0)
        match packet.kind:
            case wire.CONNECT if packet.flags & WILL and code == 0:
                self.send(WILLTOPICREQ)
            case wire.WILLTOPIC:
                self.send(WILLMSGREQ)
            case wire.CONNECT | wire.WILLMSG:
                self.send(CONNACK, code)
            case wire.SUBSCRIBE:
                topic = int.from_bytes(packet.rest, "big") if packet.flags & 3 == PREDEFINED else 0
                self.send(SUBACK, packet.flags & QOS_1, topic, packet.msg_id, code)
            case wire.UNSUBSCRIBE:
                self.send(UNSUBACK, packet.msg_id)
            case wire.PINGREQ:
                self.send(PINGRESP)
            case wire.DISCONNECT:
                self.send(DISCONNECT)
            case _:
                super().on_packet(packet)


class AirKit(UavKit):
    """The world of a UAV client over datagrams."""

    def __init__(
        self,
        gateway: Gateway,
        drone: int,
        topics: FogSide,
        autopilot: Autopilot,
        subject: Subject,
        clock: SessionClock,
    ) -> None:
        super().__init__(drone, topics, autopilot, gateway, subject, clock)
        self.air = gateway

    def leaves_unanswered(self, which: Callable[[Packet], bool]) -> None:
        self.air.answers = lambda packet: not which(packet)

    async def calm(self) -> None:
        self.air.answers = lambda packet: True
        self.air.codes.clear()
        await super().calm()

    async def flown(self, message: CommandMessage, mark: int = 0) -> str:
        """Expect one write and one last word, `completed`, of a sent command; returns the evidence."""
        words = await self.outcome(message)
        await asyncio.sleep(QUIET_S)
        words = self.words(message.gs_session, message.seq)
        lasts = [name for name in words.names if name not in ("accepted", "in_progress")]
        expect(lasts == ["completed"], f"{message.command.name}: expected one `completed`, came {words}")
        written = self.autopilot.flights(mark, ARM)
        expect(len(written) == 1, f"{message.command.name} was written {len(written)} times")
        return f"{message.command.name}: {words}"

    @property
    def commands_topic(self) -> str:
        return self.topics.commands(self.drone)

    def id_of(self, topic: str) -> int:
        return next(number for number, name in self.air.ids.items() if name == topic)

    def connects(self, mark: int = 0) -> list[Packet]:
        return self.air.packets(CONNECT, mark)

    async def greeted(self, mark: int, limit_s: float) -> None:
        """Wait for a CONNECT from another port with the same session; raises Broken."""
        before = {packet.sender for packet in self.air.came[:mark]}
        heard = len(self.tap.heard)
        found = await self.air.until(lambda: self.connects(mark), limit_s)
        expect(found, f"no CONNECT within {limit_s:g} s")
        expect(found[-1].sender not in before, f"CONNECT from port {found[-1].sender[1]}, which it had before")
        session = self.session
        await self.meet(heard)
        expect(self.session == session, f"session {self.session} on the new connection, {session} before")
