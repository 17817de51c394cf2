"""The kit's connections to one or several nodes of a broker under test, and the topics that it uses there."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.errors import ConfigurationError
from mqttxt.security.identity import Identity

from .registry import Broken, NotTested, expect
from .tap import CONNECT_S, NO_PUBACK, Heard, Tap, clear_retained, resolve

COMES_S = 3.0
"""How long an expected message may take, also from node to node."""
LARGEST_PACKET = 65_536
"""The Maximum Packet Size that every client of the protocol announces, bytes (R10.5)."""
_UNSPECIFIED = 0x80
"""The lowest of MQTT's reason codes that are errors."""
_ALL = "#"


@dataclass(frozen=True)
class BrokerTarget:
    """A broker's nodes, the prefix of the kit's topics there, and the identity with which the kit connects."""

    nodes: tuple[BrokerAddress, ...]
    prefix: str = ""
    identity: Identity | None = None


def properties_of(packet: int, **values: Any) -> Properties:
    """MQTT properties of a packet, by MQTT's names without blanks."""
    made = Properties(packet)  # type: ignore[no-untyped-call]
    for name, value in values.items():
        setattr(made, name, value)
    return made


class Peer(Tap):
    """One client of the kit."""

    def acknowledge_all(self) -> None:
        """Send a PUBACK for every message in `waiting`."""
        for mid in self.waiting:
            self._client.ack(mid, 1)
        self.waiting.clear()

    def watch_mids(self) -> None:
        """Keep packet ids in `waiting`, for manual acknowledgement."""
        on_message = self._client.on_message
        assert on_message is not None
        self.waiting: list[int] = []

        def take(client: Any, userdata: Any, message: Any) -> None:
            self.waiting.append(message.mid)
            on_message(client, userdata, message)

        self._client.on_message = take

    async def subscribe(self, *filters: str, options: SubscribeOptions | None = None) -> int:
        """Subscribe as `Tap.subscribe` does; raises Broken without a SUBACK."""
        try:
            return await super().subscribe(*filters, options=options)
        except TimeoutError:
            raise Broken(f"no SUBACK within {CONNECT_S:g} s") from None

    async def unsubscribe(self, topic: str) -> None:
        """Unsubscribe and wait for the UNSUBACK; raises Broken without one."""
        done: asyncio.Future[int] = self._loop.create_future()
        self._client.on_unsubscribe = lambda *_: self._call(resolve, done, 0)
        self._client.unsubscribe(topic)
        try:
            async with asyncio.timeout(CONNECT_S):
                await done
        except TimeoutError:
            raise Broken(f"no UNSUBACK within {CONNECT_S:g} s") from None

    async def fall_silent(self) -> None:
        """Stop reading and writing, and leave the socket open."""
        await self._loop.run_in_executor(None, self._client.loop_stop)

    async def leave_with_will(self) -> None:
        """Send DISCONNECT with reason code 0x04 (with will)."""
        self._client.disconnect(ReasonCode(PacketTypes.DISCONNECT, "Disconnect with will message"))
        await self._loop.run_in_executor(None, self._client.loop_stop)

    async def come(self, topic: str, payload: bytes | None = None, limit_s: float = COMES_S) -> Heard | None:
        """The first message on a topic, with `payload` if given; None if none arrives within `limit_s`."""

        def found() -> Heard | None:
            heard = (one for one in self.heard if one.topic == topic and payload in (None, one.payload))
            return next(heard, None)

        first: Heard | None = await self.until(found, limit_s)
        return first

    def on(self, topic: str) -> list[bytes]:
        """The payloads received on a topic, in order of arrival."""
        return [heard.payload for heard in self.heard if heard.topic == topic]


class BrokerKit:
    """Two connections, `sender` and `hearer`, to the first node; rules open more of them."""

    def __init__(self, target: BrokerTarget) -> None:
        self.target = target
        self.root = f"{target.prefix}mqttxt-conformance/{secrets.token_hex(4)}/"
        self.sender: Peer
        self.hearer: Peer
        self._clock = SessionClock()
        self._retained: set[str] = set()
        self._open: list[Peer] = []

    def now_ms(self) -> int:
        """The kit's clock, with which its connections stamp received messages."""
        return self._clock.now_ms()

    def topic(self, name: str) -> str:
        """A topic of the kit's own."""
        return f"{self.root}{name}"

    async def begin(self) -> None:
        """Connect to every node, twice to the first; raises ConfigurationError if the broker refuses the kit."""
        self.sender, self.hearer = await self._connect(0), await self._connect(0)
        for node in range(1, len(self.target.nodes)):
            await self._connect(node)
        where = self.target.nodes[0]
        expected = f"expected an access list that lets this client publish and subscribe below {self.root}"
        code = await self.hearer.subscribe(self.topic(_ALL))
        if code >= _UNSPECIFIED:
            raise ConfigurationError(f"{where}: refuses a subscription with reason code 0x{code:02x}; {expected}")
        code = await self.sender.publish(self.topic("begin"), b"1")
        if code >= _UNSPECIFIED and code != NO_PUBACK:
            raise ConfigurationError(f"{where}: refuses a publish with reason code 0x{code:02x}; {expected}")

    async def renew(self) -> None:
        """Reopen connections that the broker has closed, so that one broken rule does not affect the next check."""
        if self.sender.ended.done():
            self.sender = await self._connect(0)
        if self.hearer.ended.done():
            self.hearer = await self._connect(0)
            await self.hearer.subscribe(self.topic(_ALL))

    async def end(self) -> None:
        """Clear on every node what the kit retained there, and close all connections."""
        for node in range(len(self.target.nodes) if self._retained else 0):
            with contextlib.suppress(Broken):  # the node no longer answers
                async with self.peer(node) as peer:
                    await clear_retained(peer, self._retained)
        for peer in self._open:
            await peer.close()

    @contextlib.asynccontextmanager
    async def peer(self, node: int = 0, **options: Any) -> AsyncIterator[Peer]:
        """A further connection, closed cleanly at the end unless it has ended before.

        Raises Broken if the broker refuses it.
        """
        try:
            peer = await self._connect(node, **options)
        except ConfigurationError as error:
            raise Broken(str(error)) from error
        try:
            yield peer
        finally:
            self._open.remove(peer)
            await peer.close()

    async def _connect(
        self, node: int, client_id: str | None = None, manual_ack: bool = False, announced: Any = None, **options: Any
    ) -> Peer:
        address = self.target.nodes[node]
        name = client_id or self.client_id()
        peer = Peer(address, name, self._clock, self.target.identity, manual_ack=manual_ack, reconnects=False)
        if manual_ack:
            peer.watch_mids()
        if announced is not None:
            options["properties"] = properties_of(PacketTypes.CONNECT, **announced)
        self._open.append(peer)
        await peer.connect("broker", **options)
        return peer

    def client_id(self) -> str:
        """A random client id, unique to one connection."""
        return f"conformance-{secrets.token_hex(4)}"

    async def retain(self, topic: str, payload: bytes) -> None:
        """Publish with RETAIN; `end` clears the message."""
        self._retained.add(topic)
        await self.publish(topic, payload, retain=True)

    async def publish(self, topic: str, payload: bytes, by: Peer | None = None, **options: Any) -> int:
        """Publish at QoS 1 and return the PUBACK's reason code; raises Broken if it is an error or does not arrive."""
        code = await (by or self.sender).publish(topic, payload, **options)
        expect(code < _UNSPECIFIED, f"PUBACK 0x{code:02x}" if code != NO_PUBACK else "no PUBACK within 5 s")
        return code

    async def all_before(self, peer: Peer, topic: str, by: Peer | None = None) -> None:
        """Publish a marker and wait for it: an earlier message that has not arrived by then never will."""
        marker = secrets.token_bytes(8)
        await self.publish(topic, marker, by)
        expect(await peer.come(topic, marker), f"a message on {topic} did not come within {COMES_S:g} s")

    @contextlib.asynccontextmanager
    async def mortal(self, topic: str, **options: Any) -> AsyncIterator[tuple[Peer, bytes]]:
        """A client with a will on a topic, and the will's payload."""
        will = secrets.token_bytes(8)
        self._retained.add(topic)
        async with self.peer(will=(topic, will), **options) as peer:
            yield peer, will

    def need_nodes(self) -> None:
        """Raises NotTested if the broker has only one node."""
        if len(self.target.nodes) < 2:
            raise NotTested("needs the URLs of several nodes")


def options(*, qos: int = 1, **values: Any) -> SubscribeOptions:
    """Subscription options, with QoS 1 by default."""
    return SubscribeOptions(qos=qos, **values)


def publish_properties(**values: Any) -> Properties:
    """Properties of a PUBLISH."""
    return properties_of(PacketTypes.PUBLISH, **values)


def will_properties(**values: Any) -> Properties:
    """Properties of a will."""
    return properties_of(PacketTypes.WILLMESSAGE, **values)


async def first_of(found: Callable[[], Awaitable[bool]]) -> bool:
    """Whether `found` becomes true within `COMES_S`; it is polled, because each call makes a new subscription."""
    loop = asyncio.get_running_loop()
    until = loop.time() + COMES_S
    while not await found():
        if loop.time() >= until:
            return False
    return True
