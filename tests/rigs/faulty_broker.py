"""A broker with a fault: a real one behind a proxy that changes its packets, or its clients'."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import cycle
from typing import Self

from tests.rigs.mqtt_server import CONNECT, DISCONNECT, PUBACK, PUBLISH, SUBSCRIBE, Packet, encoded, read_packet
from tests.rigs.processes import free_port

CONNACK, UNSUBSCRIBE, UNSUBACK = 2, 10, 11
RETAIN = 1


@dataclass
class Passage:
    """A client's connection, as the fault sees it: the topics it published, and whether it subscribed by wildcard."""

    published: set[str] = field(default_factory=set)
    wild: bool = False
    held: Packet | None = None
    back: list[Packet] = field(default_factory=list)
    """Packets to the client in the broker's stead."""
    under_way: int = 0
    """The client's QoS 1 messages without PUBACK."""


Change = Callable[[Passage, Packet], list[Packet]]


def topic_of(packet: Packet) -> str:
    return packet.body[2 : 2 + int.from_bytes(packet.body[:2], "big")].decode()


def as_it_is(passage: Passage, packet: Packet) -> list[Packet]:
    return [packet]


@dataclass(frozen=True)
class Fault:
    """How packets from the client (`up`) and to it (`down`) are changed.

    `is_forgiving`: to the broker a broken connection ends as if the client had disconnected. At most `most` connections
    are accepted at a time.
    """

    up: Change = as_it_is
    down: Change = as_it_is
    is_forgiving: bool = False
    most: int | None = None


def without(wanted: Callable[[Passage, Packet], bool]) -> Change:
    """Leaves packets out."""
    return lambda passage, packet: [] if wanted(passage, packet) else [packet]


def changed(kind: int, change: Callable[[bytes], bytes]) -> Change:
    """Changes the body of packets of a kind."""
    return lambda _, packet: [replace(packet, body=change(packet.body)) if packet.kind == kind else packet]


def swapped(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    return lambda body: body.replace(old, new)


def _swap(passage: Passage, packet: Packet) -> list[Packet]:
    """Swap each pair of PUBLISH packets."""
    if packet.kind != PUBLISH:
        return [packet]
    held, passage.held = passage.held, None if passage.held is not None else packet
    return [packet, held] if held is not None else []


def _answer_unsubscribe(passage: Passage, packet: Packet) -> list[Packet]:
    if packet.kind != UNSUBSCRIBE:
        return [packet]
    passage.back.append(Packet(UNSUBACK, 0, packet.body[:2] + b"\0\0"))
    return []


def _plain_options(cleared: int) -> Callable[[bytes], bytes]:
    """Clear some bits of the options of a SUBSCRIBE's filters."""

    def change(body: bytes) -> bytes:
        out, at = bytearray(body), 3  # packet id, and no properties
        while at < len(body):
            at += 2 + int.from_bytes(body[at : at + 2], "big")
            out[at] &= ~cleared & 255
            at += 1
        return bytes(out)

    return change


_LAST = cycle(b"0123456789")


def _other_id(body: bytes) -> bytes:
    """Change the last character of a CONNECT's client id, to another one each time; only without properties."""
    end = 13 + int.from_bytes(body[11:13], "big")
    return body[: end - 1] + bytes([next(_LAST)]) + body[end:] if body[10] == 0 else body


def _kept_session(body: bytes) -> bytes:
    """Make a CONNECT without properties resume its session and keep it."""
    kept = bytes([body[7] & ~2 & 255]) + body[8:10] + b"\x05\x11\0\0\0\x3c"
    return body[:7] + kept + body[11:] if body[10] == 0 else body


RECEIVE_MAXIMUM = 2


def _refuse_more(passage: Passage, packet: Packet) -> list[Packet]:
    """End the connection of a client with more messages under way than Receive Maximum."""
    if packet.kind == PUBLISH and packet.qos == 1:
        if passage.under_way == RECEIVE_MAXIMUM:
            passage.back.append(Packet(DISCONNECT, 0, b"\x93"))
            return []
        passage.under_way += 1
    return [packet]


def _announce_few(passage: Passage, packet: Packet) -> list[Packet]:
    """Announce RECEIVE_MAXIMUM, and count what is acknowledged."""
    passage.under_way -= packet.kind == PUBACK
    return changed(CONNACK, swapped(b"\x21\0\x14", b"\x21" + RECEIVE_MAXIMUM.to_bytes(2, "big")))(passage, packet)


def _is_retained(passage: Passage, packet: Packet) -> bool:
    return packet.kind == PUBLISH and bool(packet.flags & RETAIN)


def _is_of_others(passage: Passage, packet: Packet) -> bool:
    return packet.kind == PUBLISH and topic_of(packet) not in passage.published


FAULTS = {
    "carries-messages": Fault(down=without(lambda _, packet: packet.kind == PUBLISH and packet.qos == 0)),
    "matches-filters": Fault(down=lambda _, packet: [packet] * (2 if packet.kind == PUBLISH else 1)),
    "gives-filters-up": Fault(up=_answer_unsubscribe),
    "delivers-to-its-publisher": Fault(
        down=without(lambda passage, packet: packet.kind == PUBLISH and topic_of(packet) in passage.published)
    ),
    "keeps-the-order": Fault(down=_swap),
    "keeps-the-order-at-qos-0": Fault(down=_swap),
    "takes-the-longest-payload": Fault(down=without(lambda _, packet: len(packet.body) > 10_000)),
    "keeps-to-a-clients-largest-packet": Fault(up=changed(CONNECT, swapped(b"\x27\0\0\x03\xe8", b"\x27\0\x0f\0\0"))),
    "keeps-to-receive-maximum": Fault(up=changed(CONNECT, swapped(b"\x21\0\x02", b"\x21\xff\xff"))),
    "takes-topic-aliases": Fault(down=changed(CONNACK, swapped(b"\x22\0\x0a", b"\x22\0\0"))),
    "says-that-nobody-hears": Fault(down=changed(PUBACK, lambda body: body[:2])),
    "takes-many-connections": Fault(most=10),
    "retains": Fault(down=without(_is_retained)),
    "shows-retained-by-wildcard": Fault(
        down=without(lambda passage, packet: passage.wild and _is_retained(passage, packet))
    ),
    "shows-retained-first": Fault(down=without(_is_retained)),
    "keeps-to-retain-handling": Fault(up=changed(SUBSCRIBE, _plain_options(0x30))),
    "keeps-retain-as-published": Fault(up=changed(SUBSCRIBE, _plain_options(0x08))),
    "publishes-wills": Fault(is_forgiving=True),
    "keeps-wills-back": Fault(up=without(lambda _, packet: packet.kind == DISCONNECT)),
    "publishes-wills-on-request": Fault(up=changed(DISCONNECT, lambda body: b"\0" + body[1:])),
    "ends-the-silent": Fault(up=changed(CONNECT, lambda body: body[:8] + b"\0\0" + body[10:])),
    "leaves-the-keep-alive": Fault(
        down=changed(CONNACK, lambda body: body[:2] + bytes([body[2] + 3]) + b"\x13\0\x3c" + body[3:])
    ),
    "forgets-sessions": Fault(up=changed(CONNECT, _kept_session)),
    "keeps-sessions": Fault(up=changed(CONNECT, swapped(b"\x11\0\0\x0e\x10", b"\x11\0\0\0\0"))),
    "drops-what-has-expired": Fault(up=changed(PUBLISH, swapped(b"\x02\0\0\0\x01", b"\x02\0\0\x0e\x10"))),
    "takes-sessions-over": Fault(up=changed(CONNECT, _other_id)),
}
"""Each fault by the rule that finds it."""
NARROW = Fault(up=_refuse_more, down=_announce_few)
"""No fault: it takes few messages at a time, and ends the connection of a client that sends more."""
FAULTS_OF_NODES = {
    "carries-between-nodes": Fault(down=without(_is_of_others)),
    "retains-on-every-node": Fault(down=without(_is_retained)),
    "publishes-wills-at-every-node": Fault(down=without(_is_of_others)),
    "takes-sessions-over-between-nodes": Fault(up=changed(CONNECT, _other_id)),
}
"""Faults of one node of several; the others are correct."""


class FaultyBroker:
    """Listens on loopback, and passes everything on to the broker at `target`, with one fault."""

    def __init__(self, target: int, fault: Fault = Fault()) -> None:
        self.port = free_port()
        self._target = target
        self._fault = fault
        self._open = 0
        self._server: asyncio.Server | None = None

    @property
    def url(self) -> str:
        return f"mqtt://127.0.0.1:{self.port}"

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._accept, "127.0.0.1", self.port)
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._fault.most is not None and self._open >= self._fault.most:
            writer.close()
            return
        self._open += 1
        passage = Passage()
        from_broker, to_broker = await asyncio.open_connection("127.0.0.1", self._target)
        down = asyncio.create_task(self._pass_down(passage, from_broker, writer))
        try:
            await self._pass_up(passage, reader, to_broker, writer)
        finally:
            self._open -= 1
            to_broker.close()
            await asyncio.wait({down})

    async def _pass_up(
        self, passage: Passage, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, back: asyncio.StreamWriter
    ) -> None:
        try:
            while True:
                packet = await read_packet(reader)
                if packet.kind == PUBLISH:
                    passage.published.add(topic_of(packet))
                passage.wild = passage.wild or (packet.kind == SUBSCRIBE and b"+" in packet.body)
                for one in self._fault.up(passage, packet):
                    writer.write(encoded(one))
                while passage.back:
                    back.write(encoded(passage.back.pop()))
        except (asyncio.IncompleteReadError, ConnectionError):
            if self._fault.is_forgiving:
                writer.write(encoded(Packet(DISCONNECT, 0, b"\0")))

    async def _pass_down(self, passage: Passage, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                for one in self._fault.down(passage, await read_packet(reader)):
                    writer.write(encoded(one))
        writer.close()
