"""The one module that talks to MQTT brokers: a connection by paho-mqtt that heals, for a role to use.

Each attempt is a new client with a clean start and session expiry 0: nothing of an old connection is sent
on a new one. What must not be lost is the role's to repeat; it knows deadlines, a queue does not.
"""

from __future__ import annotations

import asyncio
import logging
import random
import socket
import ssl
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, Protocol
from urllib.parse import unquote, urlsplit

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from ..errors import BrokerRefused, ConfigurationError
from ..roles.effects import Inbound, Publish, Subscribe, Unsubscribe, Will

logger = logging.getLogger("mqttxt.mqtt")

KEEPALIVE_S = 15
"""A dead peer is noticed after one and a half of it."""
CONNECT_TIMEOUT_S = 5.0
FIRST_PAUSE_S = 0.2
LONGEST_PAUSE_S = 5.0
SESSION_TAKEN_OVER = 0x8E
_PERMANENT = frozenset({0x84, 0x85, 0x86, 0x87, 0x8A, 0x8C, 0x90, 0x95, 0x99, 0x9A, 0x9B})
"""CONNACK reason codes that asking again cannot mend (MQTT 5.0, 3.2.2.2)."""


@dataclass(frozen=True)
class BrokerAddress:
    """Where a broker is: `mqtt://[user:password@]host[:port]`, `mqtts://` for TLS."""

    host: str
    port: int
    tls: bool = False
    username: str | None = None
    password: str | None = None

    @classmethod
    def parse(cls, url: str, what: str = "broker") -> BrokerAddress:
        """Raises ConfigurationError where `url` is no broker's."""
        expected = "expected mqtt://HOST[:PORT] or mqtts://HOST[:PORT]"
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise ConfigurationError(f"{what} {url!r}: {error}; {expected}") from error
        if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname or parts.path.strip("/"):
            raise ConfigurationError(f"{what} {url!r}: {expected}")
        tls = parts.scheme == "mqtts"
        return cls(
            parts.hostname,
            port or (8883 if tls else 1883),
            tls,
            unquote(parts.username) if parts.username else None,
            unquote(parts.password) if parts.password else None,
        )

    def __str__(self) -> str:
        return f"{'mqtts' if self.tls else 'mqtt'}://{self.host}:{self.port}"


class LinkEvents(Protocol):
    """What a connection tells its role's runner, always in the event loop's thread."""

    def connected(self, link: str) -> None: ...
    def disconnected(self, link: str) -> None: ...
    def received(self, link: str, message: Inbound) -> None: ...
    def subscribed(self, subscribe: Subscribe) -> None: ...
    def published(self, link: str, ref: Hashable, code: int) -> None: ...


class MqttLink:
    """A named connection to a broker. `run` keeps it up until it is cancelled or the broker refuses."""

    def __init__(
        self, name: str, address: BrokerAddress, client_id: str, will: Will | None, events: LinkEvents
    ) -> None:
        self.name = name
        self.address = address
        self._client_id = client_id
        self._will = will
        self._events = events
        self._client: Client | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._subscribes: dict[int, Subscribe] = {}
        self._refs: dict[int, Hashable] = {}
        self._ended: asyncio.Future[int] | None = None

    async def run(self) -> None:
        """Connect, stay connected, connect again; raises BrokerRefused when asking again is pointless."""
        self._loop = asyncio.get_running_loop()
        pause_s = FIRST_PAUSE_S
        while True:
            reason = await self._one_connection()
            if reason is None:
                pause_s = FIRST_PAUSE_S
            else:
                logger.info("%s: %s: %s; trying again", self.name, self.address, reason)
            await asyncio.sleep(pause_s * random.uniform(0.5, 1.0))
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    def publish(self, effect: Publish) -> None:
        """Hand a message to the connection; without one it is dropped, and the role hears of the reconnection."""
        client = self._client
        if client is None:
            return
        properties = None
        if effect.expiry_s is not None:
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            properties.MessageExpiryInterval = effect.expiry_s
        info = client.publish(effect.topic, effect.payload, effect.qos, effect.retain, properties)
        if effect.qos > 0 and effect.ref is not None and info.rc == MQTTErrorCode.MQTT_ERR_SUCCESS:
            self._refs[info.mid] = effect.ref

    def subscribe(self, effect: Subscribe) -> None:
        client = self._client
        if client is None:
            return
        handling = (
            SubscribeOptions.RETAIN_DO_NOT_SEND if effect.live_only else SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE
        )
        options = SubscribeOptions(qos=1, retainAsPublished=effect.live_only, retainHandling=handling)
        _, mid = client.subscribe([(topic, options) for topic in effect.filters])
        if mid is not None:
            self._subscribes[mid] = effect

    def unsubscribe(self, effect: Unsubscribe) -> None:
        if self._client is not None:
            self._client.unsubscribe(list(effect.filters))

    async def close(self) -> None:
        """A clean DISCONNECT, after what was handed over has left."""
        client, self._client = self._client, None
        if client is not None:
            await asyncio.to_thread(_disconnect, client)

    async def _one_connection(self) -> str | None:
        """One connection from CONNECT to its end; returns why it never came about, None if it did."""
        assert self._loop is not None
        loop = self._loop
        accepted: asyncio.Future[int] = loop.create_future()
        self._ended = ended = loop.create_future()
        client = self._make_client(accepted, ended)
        try:
            try:
                await asyncio.to_thread(self._connect, client)
                client.loop_start()
                code = await asyncio.wait_for(asyncio.shield(accepted), CONNECT_TIMEOUT_S)
            except TimeoutError:
                return f"no answer within {CONNECT_TIMEOUT_S:g} s"
            except OSError as error:
                return f"{error.strerror or error}"
            if code in _PERMANENT:
                raise BrokerRefused(f"{self.name}: {self.address} refused the connection with reason code 0x{code:02x}")
            if code != 0:
                return f"refused with reason code 0x{code:02x}"
            self._client = client
            self._events.connected(self.name)
            code = await ended
            if code == SESSION_TAKEN_OVER:
                raise BrokerRefused(f"{self.name}: {self.address}: another client took over the id {self._client_id}")
            if self._client is client:
                logger.info("%s: %s: connection lost", self.name, self.address)
            return None
        finally:
            was_up, self._client = self._client is client, None
            self._subscribes.clear()
            self._refs.clear()
            if was_up:
                self._events.disconnected(self.name)
            # In a thread: paho's own takes up to a second to end, and the other connections must go on.
            await asyncio.shield(asyncio.to_thread(_disconnect, client))

    def _connect(self, client: Client) -> None:
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.SessionExpiryInterval = 0
        client.connect(self.address.host, self.address.port, KEEPALIVE_S, clean_start=True, properties=properties)

    def _make_client(self, accepted: asyncio.Future[int], ended: asyncio.Future[int]) -> Client:
        client = Client(
            CallbackAPIVersion.VERSION2,
            client_id=self._client_id,
            protocol=MQTTProtocolVersion.MQTTv5,
            reconnect_on_failure=False,
        )
        client.connect_timeout = CONNECT_TIMEOUT_S
        client.max_inflight_messages_set(1000)
        if self._will is not None:
            client.will_set(self._will.topic, self._will.payload, qos=1, retain=True)
        if self.address.username is not None:
            client.username_pw_set(self.address.username, self.address.password)
        if self.address.tls:
            client.tls_set_context(ssl.create_default_context())
        self._set_callbacks(client, accepted, ended)
        return client

    def _set_callbacks(self, client: Client, accepted: asyncio.Future[int], ended: asyncio.Future[int]) -> None:
        """Every callback runs in paho's thread and only hands over to the event loop."""

        def on_connect(_c: Client, _u: Any, _f: Any, code: Any, _p: Any) -> None:
            self._hand_over(_resolve, accepted, code.value)

        def on_disconnect(_c: Client, _u: Any, _f: Any, code: Any, _p: Any) -> None:
            self._hand_over(_resolve, accepted, code.value or 0x80)
            self._hand_over(_resolve, ended, code.value)

        def on_message(_c: Client, _u: Any, message: MQTTMessage) -> None:
            inbound = Inbound(message.topic, bytes(message.payload), message.qos, message.retain)
            self._hand_over(self._if_current, client, self._events.received, self.name, inbound)

        def on_subscribe(_c: Client, _u: Any, mid: int, codes: Any, _p: Any) -> None:
            self._hand_over(self._on_subscribed, client, mid, [code.value for code in codes])

        def on_publish(_c: Client, _u: Any, mid: int, code: Any, _p: Any) -> None:
            self._hand_over(self._on_published, client, mid, code.value)

        client.on_connect = on_connect
        client.on_disconnect = on_disconnect
        client.on_message = on_message
        client.on_subscribe = on_subscribe
        client.on_publish = on_publish
        client.on_socket_open = _on_socket_open

    def _hand_over(self, act: Callable[..., None], *args: Any) -> None:
        assert self._loop is not None
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(act, *args)

    def _if_current(self, client: Client, act: Callable[..., None], *args: Any) -> None:
        """What an ended connection still had to tell belongs to nobody."""
        if client is self._client:
            act(*args)

    def _on_subscribed(self, client: Client, mid: int, codes: list[int]) -> None:
        if client is not self._client or mid not in self._subscribes:
            return
        effect = self._subscribes.pop(mid)
        refused = [topic for topic, code in zip(effect.filters, codes, strict=True) if code >= 0x80]
        if refused:
            logger.error("%s: %s does not allow to subscribe to %s", self.name, self.address, ", ".join(refused))
            assert self._ended is not None
            if not self._ended.done():
                self._ended.set_exception(
                    BrokerRefused(f"{self.name}: {self.address} refused the subscription to {refused[0]}")
                )
            return
        self._events.subscribed(effect)

    def _on_published(self, client: Client, mid: int, code: int) -> None:
        if client is self._client and mid in self._refs:
            self._events.published(self.name, self._refs.pop(mid), code)


def _resolve(future: asyncio.Future[int], value: int) -> None:
    if not future.done():
        future.set_result(value)


def _on_socket_open(_client: Client, _userdata: Any, sock: Any) -> None:
    """Without it Nagle's algorithm holds small publishes back and is what one measures."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _disconnect(client: Client) -> None:
    client.disconnect()
    client.loop_stop()
