"""A link to a broker over which nothing is delivered, though the broker answers (R9.17)."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Protocol

from mqttxt.core.address import BrokerAddress

from .registry import expect
from .relay import DOWN, Relay
from .subject import Subject
from .tap import Line

SILENT_S, ANSWER_S = 12.0, 5.0
"""The silence after which a node asks whether it is heard, and how long the answer may take."""
_LATE_S, _EARLY_S = 6.0, 2.0
_PUBLISH, _DISCONNECT = 3, 14
_WITH_WILL = 0x04


class Deaf(Relay):
    """Passes MQTT's packets on; while `is_deaf`, no PUBLISH to the client. Counts connections and DISCONNECTs."""

    def __init__(self, broker: BrokerAddress) -> None:
        super().__init__(broker)
        self.address = replace(broker, host="127.0.0.1", port=0)
        self.is_deaf = False
        self.connections = 0
        self.farewells: list[int] = []
        """The reason codes with which the client has left."""

    async def carry(self, way: str, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        self.connections += way == DOWN
        try:
            while True:
                head, body = await _packet(source)
                kind = head[0] >> 4
                if way != DOWN and kind == _DISCONNECT:
                    self.farewells.append(body[0] if body else 0)
                if not (self.is_deaf and way == DOWN and kind == _PUBLISH):
                    sink.write(head + body)
                    await sink.drain()
        except asyncio.IncompleteReadError as error:
            raise ConnectionResetError("closed") from error

    async def left(self, line: Line) -> str:
        """Be deaf until the client has left with 0x04 and come back; returns the evidence, raises Broken."""
        before, left, loop = self.connections, len(self.farewells), asyncio.get_running_loop()
        self.is_deaf, began_s = True, loop.time()
        await line.until(lambda: self.connections > before, SILENT_S + ANSWER_S + _LATE_S)
        self.is_deaf, after_s = False, loop.time() - began_s
        expect(self.connections > before, f"{after_s:.1f} s over a connection that delivers nothing: it stays there")
        codes = self.farewells[left:]
        expect(codes == [_WITH_WILL], f"left with reason codes {codes}, expected {[_WITH_WILL]}")
        expect(after_s > SILENT_S + ANSWER_S - _EARLY_S, f"left after {after_s:.1f} s")
        return f"left with 0x04 after {after_s:.1f} s over a connection that delivers nothing, and came back"


class Met(Protocol):
    """A kit that has met an implementation: `meet` waits for its birth since a mark, and sets its `session`."""

    subject: Subject
    session: int

    async def meet(self, mark: int = 0) -> None: ...


async def leaves(kit: Met, broker: BrokerAddress, line: Line) -> str:
    """Expect that the implementation, started over a Deaf link, leaves it and comes back in the same session.

    `line` is the kit's connection to `broker`. Afterwards the implementation is started anew without the link.
    """
    await kit.subject.kill()
    relay = await Deaf(broker).start()
    try:
        mark = len(line.heard)
        await kit.subject.start(broker=str(relay.address))
        await kit.meet(mark)
        session, evidence = kit.session, await relay.left(line)
        await kit.meet(len(line.heard))
        expect(kit.session == session, f"session {kit.session} on the new connection, {session} before")
    finally:
        await kit.subject.kill()
        await relay.close()
        mark = len(line.heard)
        await kit.subject.start()
        await kit.meet(mark)
    return f"{evidence}, in the same session"


async def _packet(source: asyncio.StreamReader) -> tuple[bytes, bytes]:
    """One MQTT packet: its fixed header, and what follows."""
    head, length, shift = await source.readexactly(1), 0, 0
    while True:
        (digit,) = byte = await source.readexactly(1)
        head += byte
        length |= (digit & 0x7F) << shift
        if digit < 0x80:
            return head, await source.readexactly(length)
        shift += 7
