"""The kit's ends of the air leg: MQTT-SN 1.2 as in section 20, without mqttxt's code."""

from __future__ import annotations

import asyncio
import secrets
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, cast

from mqttxt.core.clock import SessionClock
from mqttxt.errors import ConfigurationError

from .fields import COMMANDS, STATES
from .registry import Broken, expect
from .tap import Heard, Line, resolve

CONNECT, CONNACK, WILLTOPICREQ, WILLTOPIC, WILLMSGREQ, WILLMSG, REGISTER, REGACK, PUBLISH, PUBACK = range(4, 14)
SUBSCRIBE, SUBACK, UNSUBSCRIBE, UNSUBACK, PINGREQ, PINGRESP, DISCONNECT = range(0x12, 0x19)
DUP, QOS_1, RETAIN, WILL, CLEAN = 0x80, 0x20, 0x10, 0x08, 0x04
NORMAL, PREDEFINED = 0, 1
"""The types of a topic id: registered, or predefined by section 20."""
TOGETHER, REVOKED = 1, 2
LARGEST = 1200
LEAST_MS, LONGEST_MS = 100, 2000
"""Bounds of the pause before a packet is repeated (R20.5)."""
GRACE_MS = 400
"""The delay that a busy machine may add."""
AGAIN_S = 1.0
"""How long the kit waits before it repeats an unanswered PUBLISH."""
HEADERS = 28
"""Bytes of the headers of IPv4 and UDP."""
_PLACES = {
    CONNECT: ("flags protocol duration", ">BBH"),
    CONNACK: ("code", ">B"),
    WILLTOPIC: ("flags", ">B"),
    REGISTER: ("topic msg_id", ">HH"),
    REGACK: ("topic msg_id code", ">HHB"),
    PUBLISH: ("flags topic msg_id", ">BHH"),
    PUBACK: ("topic msg_id code", ">HHB"),
    SUBSCRIBE: ("flags msg_id", ">BH"),
    SUBACK: ("flags topic msg_id code", ">BHHB"),
    UNSUBSCRIBE: ("flags msg_id", ">BH"),
    UNSUBACK: ("msg_id", ">H"),
}
"""The numeric fields at the start of each kind of packet, with their layout."""
_STREAM = struct.Struct(">BHHH")
_NAMES = (
    "reachable", "clock", "init_connect", "stations", "control",
    "states", "commands", "bulk", "bulk_answer", "sensor_ack",
)  # fmt: skip

Address = tuple[Any, ...]


@dataclass(frozen=True)
class Packet:
    """A received packet with the time and sender; numeric fields that its kind lacks are 0."""

    kind: int
    rest: bytes = b""
    flags: int = 0
    topic: int = 0
    msg_id: int = 0
    code: int = 0
    duration: int = 0
    protocol: int = 0
    at_ms: int = 0
    sender: Address = ()
    size: int = 0

    @property
    def is_sure(self) -> bool:
        """A PUBLISH at QoS 1."""
        return self.kind == PUBLISH and self.flags & QOS_1 != 0

    @property
    def same(self) -> Packet:
        """The packet without DUP and time, to compare copies."""
        return replace(self, flags=self.flags & ~DUP, at_ms=0)


def write(kind: int, *numbers: int, rest: bytes = b"") -> bytes:
    """The datagram of a packet."""
    body = bytes((kind,)) + (struct.pack(_PLACES[kind][1], *numbers) if kind in _PLACES else b"") + rest
    return bytes((len(body) + 1,)) + body if len(body) < 255 else b"\1" + (len(body) + 3).to_bytes(2, "big") + body


def read(data: bytes, at_ms: int = 0, sender: Address = ()) -> Packet:
    """Read a datagram; raises Broken if it is no packet of section 20."""
    start = 3 if data[:1] == b"\1" else 1
    length = int.from_bytes(data[1:3], "big") if start == 3 else data[0] if data else 0
    kind = data[start] if len(data) > start else 0
    if length != len(data) or not (CONNECT <= kind <= PUBACK or SUBSCRIBE <= kind <= DISCONNECT):
        raise Broken(f"datagram {data[:24].hex(' ')}: no packet of MQTT-SN 1.2 that R20.1 names")
    names, layout = _PLACES.get(kind, ("", ">"))
    behind = start + 1 + struct.calcsize(layout)
    if len(data) < behind:
        raise Broken(f"datagram {data.hex(' ')}: too short for its kind")
    numbers = dict(zip(names.split(), struct.unpack(layout, data[start + 1 : behind]), strict=True))
    return Packet(kind, data[behind:], at_ms=at_ms, sender=sender, size=len(data), **numbers)


def ids_of(root: str, drone: int) -> dict[int, str]:
    """The topics of a drone, by predefined id (R20.3)."""
    below = {number: f"state/{name}" for number, name in enumerate(STATES, start=1)}
    below |= {64 + code: f"commands_result/{name or 'malformed'}" for code, name in enumerate(COMMANDS)}
    below |= dict(enumerate(_NAMES, start=128))
    return {
        REVOKED: f"{root}fleet/revoked",
        **{drone << 8 | low: f"{root}drone{drone}/{n}" for low, n in below.items()},
    }


def together(ids: dict[int, str], *messages: tuple[str, bytes]) -> bytes:
    """Messages at QoS 1, joined to one stream (R20.6)."""
    numbers = {topic: number for number, topic in ids.items()}
    heads = [(_STREAM.pack(QOS_1, numbers[topic], 0, len(payload)), payload) for topic, payload in messages]
    return b"".join(head + payload for head, payload in heads)


class AirLine(Line, asyncio.DatagramProtocol):
    """One end: answers packets, and has one PUBLISH at QoS 1 under way, which it repeats until it is answered.

    `came` has every packet in order of arrival. `answers` decides whether a packet is answered; `codes` has the return
    code, by the kind of packet answered. Each message is taken once, under the topic that `ids` gives.
    """

    def __init__(self, ids: dict[int, str], clock: SessionClock) -> None:
        super().__init__(clock)
        self.ids = ids
        self.came: list[Packet] = []
        self.sent_bytes = self.came_bytes = 0
        self.answers: Callable[[Packet], bool] = lambda packet: True
        self.codes: dict[int, int] = {}
        self.faults: list[str] = []
        """The errors of datagrams that were no packets."""
        self.peer: Address | None = None
        """The other end's address, to which packets are sent."""
        self._transport: asyncio.DatagramTransport | None = None
        self._waiting: deque[tuple[int, int, int, bytes, asyncio.Future[int]]] = deque()
        self._msg_id = secrets.randbelow(1000)
        self._again: asyncio.TimerHandle | None = None
        self._last = 0
        self._stream = b""

    async def open(self, what: str, local: Address | None = None, remote: Address | None = None) -> None:
        """Open the socket; raises ConfigurationError, which names the option `what`."""
        try:
            await self._loop.create_datagram_endpoint(lambda: self, local_addr=local, remote_addr=remote)
        except OSError as error:
            host, port = local or remote or ("", 0)
            raise ConfigurationError(f"{what} {host}:{port}: {error.strerror or error}") from error

    @property
    def next_id(self) -> int:
        """A new message id, for a packet that needs an answer."""
        self._msg_id = self._msg_id % 65_535 + 1
        return self._msg_id

    def send(self, kind: int, *numbers: int, rest: bytes = b"", to: Address | None = None) -> None:
        data = write(kind, *numbers, rest=rest)
        self.sent_bytes += len(data)
        if self._transport is not None:
            self._transport.sendto(data, to or self.peer)

    def publish(
        self,
        topic: str,
        payload: bytes,
        *,
        qos: int = 1,
        retain: bool = False,
        expiry_s: int | None = None,
        as_it_is: bool = False,
    ) -> asyncio.Future[int]:
        """Publish; the future is the PUBACK's return code. Empty payloads, to clear retained messages, are not sent."""
        done: asyncio.Future[int] = self._loop.create_future()
        topic_id = next((number for number, name in self.ids.items() if name == topic), None)
        if not payload or topic_id is None:
            done.set_result(0)
            return done
        flags = PREDEFINED | RETAIN * retain
        if qos == 0:
            self.send(PUBLISH, flags, topic_id, 0, rest=payload)
            done.set_result(0)
            return done
        return self.surely(flags, topic_id, payload)

    def surely(self, flags: int, topic_id: int, payload: bytes) -> asyncio.Future[int]:
        """Queue a PUBLISH at QoS 1."""
        done: asyncio.Future[int] = self._loop.create_future()
        self._waiting.append((flags | QOS_1, topic_id, self.next_id, payload, done))
        if len(self._waiting) == 1:
            self._say(0)
        return done

    def packets(self, kind: int, mark: int = 0) -> list[Packet]:
        """The packets of a kind, from number `mark` of `came` on."""
        return [packet for packet in self.came[mark:] if packet.kind == kind]

    async def close(self) -> None:
        if self._again is not None:
            self._again.cancel()
        if self._transport is not None:
            self._transport.close()

    async def repeated(self, mark: int, patience_s: float) -> tuple[list[Packet], list[int]]:
        """The copies, from packet number `mark` on, of an unanswered PUBLISH, and the pauses between them in ms.

        Waits for four copies; raises Broken if they violate R20.5 or another PUBLISH at QoS 1 is among them.
        """

        def sure() -> list[Packet]:
            return [one for one in self.packets(PUBLISH, mark) if one.is_sure]

        await self.until(lambda: len(sure()) >= 4, patience_s)
        copies = sure()
        expect(len(copies) >= 4, f"{len(copies)} PUBLISHes at QoS 1 within {patience_s:g} s, which nobody answered")
        expect(len({one.same for one in copies}) == 1, "another PUBLISH at QoS 1 before the first was answered")
        marks = [one.flags & DUP != 0 for one in copies]
        expect(marks == [False] + [True] * (len(marks) - 1), f"DUP of the copies: {marks}")
        pauses = [later.at_ms - earlier.at_ms for earlier, later in pairwise(copies)]
        are_right = all(LEAST_MS - 20 <= pause <= LONGEST_MS + GRACE_MS for pause in pauses)
        expect(are_right and pauses[2] > pauses[0], f"pauses of {pauses} ms")
        return copies, pauses

    def forget(self) -> None:
        """Reset for a new connection: drop the queue and a partial stream."""
        self._waiting.clear()
        self._last, self._stream = 0, b""
        if self._again is not None:
            self._again.cancel()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self.came_bytes += len(data)
        try:
            packet = read(data, self._clock.now_ms(), addr)
        except Broken as broken:
            self.faults.append(str(broken))
            return
        self.came.append(packet)
        self.on_packet(packet)
        self._arrived.set()

    def on_packet(self, packet: Packet) -> None:
        """Take messages, and the answers to this end's own."""
        if packet.kind == PUBACK and self._waiting and self._waiting[0][2] == packet.msg_id:
            resolve(self._waiting.popleft()[-1], packet.code)
            if self._waiting:
                self._say(0)
        elif packet.kind == PUBLISH and (not packet.is_sure or self.answers(packet)):
            code = self.codes.get(PUBLISH, 0)
            if packet.is_sure:
                self.send(PUBACK, packet.topic, packet.msg_id, code)
            if not packet.is_sure or (packet.msg_id != self._last and code == 0):
                self._last = packet.msg_id if packet.is_sure else self._last
                self._hear(packet)

    def _hear(self, packet: Packet) -> None:
        if packet.topic != TOGETHER:
            self._heard(self.ids.get(packet.topic, f"topic id {packet.topic}"), packet.rest, packet.flags)
            return
        self._stream += packet.rest
        while len(self._stream) >= _STREAM.size:
            flags, topic_id, name, length = _STREAM.unpack_from(self._stream)
            begin, end = _STREAM.size + name, _STREAM.size + name + length
            if len(self._stream) < end:
                return
            topic = self._stream[_STREAM.size : begin].decode() if name else self.ids.get(topic_id, f"id {topic_id}")
            payload, self._stream = self._stream[begin:end], self._stream[end:]
            self._heard(topic, payload, flags)

    def _heard(self, topic: str, payload: bytes, flags: int) -> None:
        qos, retain = int(flags & QOS_1 != 0), flags & RETAIN != 0
        self.take(Heard(self._clock.now_ms(), topic, payload, qos, retain, None))

    def _say(self, dup: int) -> None:
        """Send the first queued PUBLISH, and repeat it until it is answered."""
        if self._again is not None:
            self._again.cancel()
        if self._waiting:
            flags, topic_id, msg_id, payload, _ = self._waiting[0]
            self.send(PUBLISH, flags | dup, topic_id, msg_id, rest=payload)
            self._again = self._loop.call_later(AGAIN_S, self._say, DUP)
