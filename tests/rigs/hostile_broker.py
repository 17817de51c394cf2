"""A broker that speaks MQTT 5 on real sockets and treats messages as an attacker would."""

from __future__ import annotations

import asyncio
import ssl
from collections import Counter, defaultdict
from collections.abc import Callable
from itertools import count
from pathlib import Path
from random import Random

from mqttxt.core.settings import NO_MATCHING_SUBSCRIBERS
from tests.rigs.mqtt_server import PUBLISH, SUBSCRIBE, Server, Session, publish
from tests.simulation.world import matches

PINGREQ = 12
Delivery = tuple[float, str, bytes]
"""The delay of a delivery in seconds, its topic and its payload."""
Attack = Callable[[str, bytes], list[Delivery]]
"""Turns a message's topic and payload into deliveries."""


class _Client(Session):
    """One client of the broker; `filters` are its subscriptions."""

    broker: HostileBroker

    async def serve(self) -> None:
        self.filters: list[str] = []
        self._mids = count()
        try:
            while True:
                packet = await self.read()
                if packet.kind == SUBSCRIBE:
                    self._subscribe(packet.body)
                elif packet.kind == PUBLISH:
                    topic, _, payload, mid = packet.publish()
                    if packet.qos:
                        self.send(b"\x40\x03" + mid.to_bytes(2, "big") + bytes([self.broker.reason_code()]))
                    self.broker.take(topic, payload, packet.qos, retain=bool(packet.flags & 1))
                elif packet.kind == PINGREQ:
                    self.send(b"\xd0\0")
        except (asyncio.IncompleteReadError, ConnectionError):
            self.ended = True
        finally:
            self._writer.close()

    def _subscribe(self, body: bytes) -> None:
        rest = body[3 + body[2] :]
        wanted = []
        while rest:
            end = 2 + int.from_bytes(rest[:2], "big")
            is_live_only = rest[end] & 0x30 == 0x20
            wanted.append((rest[2:end].decode(), is_live_only))
            rest = rest[end + 1 :]
        self.send(bytes([0x90, 3 + len(wanted)]) + body[:2] + b"\0" + b"\1" * len(wanted))
        for topic_filter, is_live_only in wanted:
            self.filters.append(topic_filter)
            for topic, payload in [] if is_live_only else list(self.broker.retained.items()):
                if matches(topic_filter, topic):
                    self.deliver(topic, payload, 1)

    def deliver(self, topic: str, payload: bytes, qos: int) -> None:
        if any(matches(wanted, topic) for wanted in self.filters):
            self.send(publish(topic, payload, qos, next(self._mids) % 65_535 + 1))


class HostileBroker(Server):
    """Acknowledges everything, sometimes as if nobody had subscribed.

    `attacks` apply to the next message of a topic. Some others it repeats: the message itself, or an older one of its
    topic.
    """

    def __init__(self, identity: Path, seed: int) -> None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(identity / "certificate.pem", identity / "identity.pem")
        super().__init__(tls=context)
        self.attacks: dict[str, Attack] = {}
        self.retained: dict[str, bytes] = {}
        self.repeated: Counter[str] = Counter()
        self._older: defaultdict[str, list[bytes]] = defaultdict(list)
        self._rng = Random(seed)

    def make_session(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> Session:
        session = _Client(reader, writer, True, iter(()))
        session.broker = self
        return session

    def reason_code(self) -> int:
        return self._rng.choice((0, 0, 0, NO_MATCHING_SUBSCRIBERS))

    def take(self, topic: str, payload: bytes, qos: int, retain: bool) -> None:
        """Take a message that a client has published."""
        if retain:
            self.retained[topic] = payload
        attack = self.attacks.pop(topic, self._repeat)
        for delay_s, moved, said in attack(topic, payload):
            asyncio.get_running_loop().call_later(delay_s, self.deliver, moved, said, qos)
        self._older[topic].append(payload)

    def deliver(self, topic: str, payload: bytes, qos: int) -> None:
        for session in self.sessions:
            if isinstance(session, _Client) and not session.ended:
                session.deliver(topic, payload, qos)

    def _repeat(self, topic: str, payload: bytes) -> list[Delivery]:
        rng, said = self._rng, [(0.0, topic, payload)]
        if rng.random() < 0.3:
            again = rng.choice([payload, *self._older[topic][-100:]])
            said.append((rng.choice((0.0, 0.05, 0.5)), topic, again))
            self.repeated[topic] += 1
        return said
