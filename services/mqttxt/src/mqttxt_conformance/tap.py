"""The kit's own connections: each keeps every message that it receives, with its RETAIN flag and expiry."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.core.mqtt.tls import client_context
from mqttxt.errors import ConfigurationError
from mqttxt.security.identity import Identity

CONNECT_S = 5.0
NOBODY_SUBSCRIBED = 0x10
NO_PUBACK = 0x100
"""Stands for a PUBACK that did not arrive; no reason code of one byte."""
PUBACK_S = 5.0


@dataclass(frozen=True)
class Heard:
    """A received message, and the time of its arrival in milliseconds of the kit's clock."""

    at_ms: int
    topic: str
    payload: bytes
    qos: int
    retain: bool
    expiry_s: int | None
    properties: Properties | None = None


class Line(ABC):
    """A connection of the kit: publishes messages, and keeps the received ones in order of arrival.

    Where messages are signed, `seal` signs a published payload, and `read` unwraps a received envelope.
    """

    def __init__(self, clock: SessionClock) -> None:
        self.heard: list[Heard] = []
        self.seal: Callable[[str, bytes], bytes] = lambda topic, payload: payload
        self.read: Callable[[Heard], Heard] = lambda heard: heard
        self.on_heard: Callable[[Heard], None] = lambda heard: None
        self._clock = clock
        self._loop = asyncio.get_running_loop()
        self._arrived = asyncio.Event()

    @abstractmethod
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
        """Publish; the future is the acknowledgement's reason code. With `as_it_is` nothing is sealed."""

    @abstractmethod
    async def close(self) -> None: ...

    def since(self, mark: int, topic: str | None = None, below: str | None = None) -> list[Heard]:
        """The messages from number `mark` on, on one topic or below one if given."""
        return [
            heard
            for heard in self.heard[mark:]
            if (topic is None or heard.topic == topic) and (below is None or heard.topic.startswith(below))
        ]

    async def until(self, condition: Callable[[], Any], limit_s: float) -> Any:
        """The condition's first true value, evaluated at each message or 0.1 s; after `limit_s` its last value."""
        deadline = self._loop.time() + limit_s
        while not (value := condition()) and (left := deadline - self._loop.time()) > 0:
            self._arrived.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(min(left, 0.1)):
                    await self._arrived.wait()
        return value

    def take(self, heard: Heard) -> None:
        """Keep and report a received message."""
        heard = self.read(heard)
        self.heard.append(heard)
        self.on_heard(heard)
        self._arrived.set()


class _Client(Client):
    """paho's client, which by itself does not keep to the broker's Receive Maximum."""

    def keep_to(self, connack: Properties) -> None:
        """Have no more QoS 1 messages under way than the broker allows (R10.5)."""
        most = self._max_inflight_messages
        self._max_inflight_messages = min(getattr(connack, "ReceiveMaximum", most), most)


class Tap(Line):
    """One connection to a broker, by default without its own publishes; over TLS with `identity`'s certificate."""

    def __init__(
        self,
        address: BrokerAddress,
        client_id: str,
        clock: SessionClock,
        identity: Identity | None = None,
        *,
        manual_ack: bool = False,
        reconnects: bool = True,
    ) -> None:
        super().__init__(clock)
        self.address = address
        self._connected: asyncio.Future[int] = self._loop.create_future()
        self.connack = Properties(PacketTypes.CONNACK)  # type: ignore[no-untyped-call]
        """The properties of the broker's CONNACK."""
        self.ended: asyncio.Future[int] = self._loop.create_future()
        """The reason code of the connection's end."""
        self._pubacks: dict[int, asyncio.Future[int]] = {}
        self._subacks: dict[int, asyncio.Future[int]] = {}
        self._client = _Client(
            CallbackAPIVersion.VERSION2,
            client_id=client_id,
            protocol=MQTTProtocolVersion.MQTTv5,
            manual_ack=manual_ack,
            reconnect_on_failure=reconnects,
        )
        self._client.connect_timeout = CONNECT_S
        if address.username is not None:
            self._client.username_pw_set(address.username, address.password)
        if address.tls:
            context = client_context(identity) if identity is not None else ssl.create_default_context()
            self._client.tls_set_context(context)
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = lambda _c, _u, _f, code, _p: self._call(resolve, self.ended, code.value)
        self._client.on_message = self._on_message
        self._client.on_publish = lambda _c, _u, mid, code, _p: self._call(self._acknowledged, mid, code.value)
        self._client.on_subscribe = lambda _c, _u, mid, codes, _p: self._call(
            self._subscribed, mid, max(one.value for one in codes)
        )

    async def connect(
        self,
        what: str,
        will: tuple[str, bytes] | None = None,
        *,
        will_properties: Properties | None = None,
        keepalive_s: int = 60,
        clean_start: bool = True,
        properties: Properties | None = None,
    ) -> None:
        """Connect; raises ConfigurationError, which names the option `what`, if no broker answers or it refuses."""
        if will is not None:
            topic, payload = will
            self._client.will_set(topic, payload, qos=1, retain=True, properties=will_properties)
        try:
            await self._loop.run_in_executor(
                None,
                lambda: self._client.connect(
                    self.address.host,
                    self.address.port,
                    keepalive_s,
                    clean_start=clean_start,
                    properties=properties,
                ),
            )
            self._client.loop_start()
            async with asyncio.timeout(CONNECT_S):
                code = await self._connected
        except (OSError, TimeoutError) as error:
            raise ConfigurationError(f"{what} {self.address}: no broker answers: {error or 'time-out'}") from error
        if code != 0:
            raise ConfigurationError(f"{what} {self.address}: the broker refused with reason code 0x{code:02x}")

    async def subscribe(self, *filters: str, options: SubscribeOptions | None = None) -> int:
        """Subscribe; by default at QoS 1, with retained messages, Retain As Published and No Local.

        Returns the highest of the SUBACK's reason codes; raises TimeoutError without a SUBACK.
        """
        options = options or SubscribeOptions(qos=1, noLocal=True, retainAsPublished=True)
        _, mid = self._client.subscribe([(one, options) for one in filters])
        assert mid is not None
        done = self._subacks.setdefault(mid, self._loop.create_future())
        async with asyncio.timeout(CONNECT_S):
            return await done

    def publish(
        self,
        topic: str,
        payload: bytes,
        *,
        qos: int = 1,
        retain: bool = False,
        expiry_s: int | None = None,
        as_it_is: bool = False,
        properties: Properties | None = None,
    ) -> asyncio.Future[int]:
        """Publish; the future is the PUBACK's reason code, NO_PUBACK after PUBACK_S; with `as_it_is` not sealed."""
        payload = payload if as_it_is or not payload else self.seal(topic, payload)
        properties = properties or Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        if expiry_s is not None:
            properties.MessageExpiryInterval = expiry_s
        info = self._client.publish(topic, payload, qos, retain, properties)
        acknowledged = self._pubacks.setdefault(info.mid, self._loop.create_future())
        self._loop.call_later(PUBACK_S, resolve, acknowledged, NO_PUBACK)
        return acknowledged

    async def close(self, cleanly: bool = True) -> None:
        """Disconnect; if not `cleanly` without DISCONNECT, as after a power loss."""
        if cleanly:
            self._client.disconnect()
        else:
            self._client.socket().close()  # type: ignore[union-attr]
        await self._loop.run_in_executor(None, self._client.loop_stop)

    def _call(self, act: Callable[..., None], *args: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(act, *args)

    def _on_message(self, _client: Client, _userdata: Any, message: MQTTMessage) -> None:
        heard = Heard(
            at_ms=self._clock.now_ms(),
            topic=message.topic,
            payload=bytes(message.payload),
            qos=message.qos,
            retain=message.retain,
            expiry_s=getattr(message.properties, "MessageExpiryInterval", None),
            properties=message.properties,
        )
        self._call(self.take, heard)

    def _on_connect(
        self, _client: Client, _userdata: Any, _flags: Any, code: ReasonCode, said: Properties | None
    ) -> None:
        self.connack = said or self.connack
        self._client.keep_to(self.connack)
        self._call(resolve, self._connected, code.value)

    def _acknowledged(self, mid: int, code: int) -> None:
        resolve(self._pubacks.setdefault(mid, self._loop.create_future()), code)

    def _subscribed(self, mid: int, code: int) -> None:
        resolve(self._subacks.setdefault(mid, self._loop.create_future()), code)


def resolve(future: asyncio.Future[int], value: int) -> None:
    """Set a future's result unless it has one."""
    if not future.done():
        future.set_result(value)


async def clear_retained(tap: Line, topics: Iterable[str]) -> None:
    """Clear the retained messages on some topics; a missing PUBACK is ignored."""
    await asyncio.gather(*(tap.publish(topic, b"", retain=True) for topic in topics))
