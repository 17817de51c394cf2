"""One connection to a broker, from CONNECT to its end: paho-mqtt inside the event loop, without its thread.

Messages bypass paho (`incoming`, `outgoing`). Its callbacks only take notes. These are delivered after paho has
returned, so that a role may publish, and fail, without paho being half-way through a packet.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import struct
from functools import partial
from typing import TYPE_CHECKING, Any

from paho.mqtt.client import Client
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode

from ...errors import BrokerRefused
from ..address import BrokerAddress
from ..effects import Unsubscribe, Will
from .aliases import BrokersAliases
from .client import CONNECT_TIMEOUT_S, KEEPALIVE_S, connect, in_own_thread, make_client
from .events import LinkEvents
from .incoming import Incoming
from .keep_alive import KeepAlive
from .outgoing import Outgoing
from .packets import PINGREQ
from .subscriptions import Subscriptions

if TYPE_CHECKING:
    from ...security.identity import Identity
    from .buffered import Buffered

logger = logging.getLogger("mqttxt.mqtt")

_VOID_BYTES = 65_536
_MISC_S = 1.0
_RESET = struct.pack("ii", 1, 0)
"""For SO_LINGER: closing drops what is not acknowledged, and resets the connection."""
_WITH_WILL = ReasonCode(PacketTypes.DISCONNECT, "Disconnect with will message")


class Connection:
    """One client connection. With `session_expiry_s` 0 its start is clean and its session ends with it.

    `aliases` is how many topics the broker may give aliases to.
    """

    def __init__(
        self,
        name: str,
        address: BrokerAddress,
        client_id: str,
        will: Will | None,
        events: LinkEvents,
        manual_ack: bool = False,
        session_expiry_s: int = 0,
        ssl_context: ssl.SSLContext | None = None,
        aliases: int = 0,
    ) -> None:
        self.name = name
        self.address = address
        self._session_expiry_s = session_expiry_s
        self._events = events
        self._loop = asyncio.get_running_loop()
        self.ended: asyncio.Future[int] = self._loop.create_future()
        """The reason code of the connection's end; fails with BrokerRefused if a subscription was refused for good."""
        self._accepted: asyncio.Future[int] = self._loop.create_future()
        self.refusal: str | None = None
        """Why this connection was given up although the broker had accepted it."""
        self._aliases = BrokersAliases(aliases)
        self._keep_alive = KeepAlive()
        self._client = client = make_client(address, client_id, will, ssl_context)
        self._outgoing = Outgoing(
            name, address, client, events, failed=lambda: self._loop.call_soon(self._incoming.take)
        )
        self._incoming = Incoming(
            name,
            address,
            client,
            events,
            self._outgoing,
            self._keep_alive,
            self._aliases,
            manual_ack=manual_ack,
            broken=lambda: self.close(with_will=True),
        )
        self.publish, self.acknowledge = self._outgoing.publish, self._incoming.acknowledge
        self._subscriptions = Subscriptions(client, events.subscribed, self._refused)
        self.subscribe = self._subscriptions.subscribe
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_subscribe = self._on_subscribe

    async def open(self) -> int:
        """Connect; returns the CONNACK's reason code. Raises OSError, TimeoutError if only the CONNACK is missing."""
        # paho blocks while it resolves, connects and shakes hands: a thread does that, this loop all else.
        connecting = in_own_thread(
            partial(connect, self._client, self.address, self._session_expiry_s, self._aliases.maximum)
        )
        try:
            await asyncio.shield(connecting)
        except TimeoutError as error:
            raise ConnectionError("no answer in time") from error
        except asyncio.CancelledError:
            connecting.add_done_callback(self._abandon)
            raise
        sock = self._socket
        if sock is None:
            raise ConnectionResetError("connection closed")
        self._client.on_socket_register_write = lambda *_: self._outgoing.flush_soon()
        self._client.on_socket_close = self._on_socket_close
        self._keep_alive.heard_s = self._loop.time()
        self._loop.add_reader(sock, self._incoming.readable)
        self._loop.call_later(_MISC_S, self._look_after)
        self._outgoing.flush()
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            return await asyncio.shield(self._accepted)

    @property
    def was_served(self) -> bool:
        """Whether the broker has delivered or acknowledged a message, or answered a ping."""
        return self._incoming.was_served

    @property
    def _socket(self) -> Buffered | None:
        """The socket; None if it is closed."""
        return self._outgoing.sock

    def unsubscribe(self, effect: Unsubscribe) -> None:
        self._client.unsubscribe(list(effect.filters))

    def ping(self) -> None:
        """Send a PINGREQ, unless one is unanswered."""
        if not self._keep_alive.is_owed and self._socket is not None:
            self._keep_alive.ask(self._loop.time())
            self._outgoing.send(PINGREQ)

    def usual_s(self) -> float:
        """The usual upper bound of the broker's round trip, s; infinite if an answer is overdue."""
        return self._keep_alive.usual_s(self._loop.time())

    def wrong_with_broker(self, identity: Identity) -> str | None:
        """Why the broker's certificate is not good now, as text; None while it is good."""
        from .tls import wrong_with

        sock = self._socket.sock if self._socket is not None else None
        return wrong_with(identity, sock.getpeercert(binary_form=True)) if isinstance(sock, ssl.SSLSocket) else None

    def give_up(self, reason: str) -> None:
        """End a connection that the broker had accepted; the link then opens a new one."""
        self.refusal = reason
        self.close(with_will=True)

    async def settled(self, limit_s: float) -> None:
        """Wait, at most `limit_s`, until every message is written and, at QoS 1, acknowledged."""
        ends: set[asyncio.Future[Any]] = {self._outgoing.settled(), self.ended}
        await asyncio.wait(ends, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)

    def close(self, *, with_will: bool = False) -> None:
        """Write pending messages and DISCONNECT, as far as the system accepts them now; then close the socket.

        The broker publishes the will `with_will`, and also if messages were never sent because the broker acknowledged
        too few: the goodbye is the last of these. A CONNECT without an answer is taken back: the system would repeat it
        for minutes, and the broker then end the next connection, whose client id is the same.
        """
        if not self._accepted.done() and self._socket is not None:
            with contextlib.suppress(OSError):  # closed already
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        reason = _WITH_WILL if with_will or self._outgoing.has_waiting else None
        if self._client.disconnect(reason) == MQTTErrorCode.MQTT_ERR_SUCCESS:
            self._outgoing.flush()
        sock = self._socket
        if sock is not None:  # paho has not closed it
            self._on_socket_close(self._client, None, sock)
            sock.close()
        _resolve(self.ended, 0)

    async def leave(self, limit_s: float) -> None:
        """`close`, then read and discard data until the broker has closed too, for at most `limit_s`.

        Closing a socket with unread data resets the connection (RFC 2525, section 2.17): pending messages and the
        DISCONNECT would be lost, and the broker would publish the will of a client that stopped cleanly.
        """
        sock = self._socket
        if sock is None:
            self.close()
            return
        with socket.socket(fileno=socket.dup(sock.fileno())) as rest:
            self.close()
            rest.setblocking(False)
            with contextlib.suppress(OSError):  # reset nevertheless, or not closed in time
                rest.shutdown(socket.SHUT_WR)
                async with asyncio.timeout(limit_s):
                    while await self._loop.sock_recv(rest, _VOID_BYTES):
                        pass

    def _abandon(self, connecting: asyncio.Future[None]) -> None:
        """Close a connection whose `open` was cancelled, whether or not it succeeded."""
        connecting.exception()
        self.close()

    # Called by the event loop.

    def _look_after(self) -> None:
        """Keep-alive: ping the broker after a silence in either direction; give it up if it does not answer."""
        sock, now_s = self._socket, self._loop.time()
        if self.ended.done() or sock is None:
            return
        # A broker may ask for a shorter keep-alive, not for a longer one.
        keepalive_s = min(self._client.keepalive or KEEPALIVE_S, KEEPALIVE_S)
        if self._keep_alive.is_lost(now_s, keepalive_s):
            logger.info("%s: %s does not answer", self.name, self.address)
            self.close(with_will=True)
            return
        if self._keep_alive.is_left_out(self._subscriptions.under_way or self._outgoing.oldest, KEEPALIVE_S):
            logger.warning("%s: %s has left out a PUBACK or SUBACK", self.name, self.address)
            self.close(with_will=True)
            return
        if self._keep_alive.is_due(now_s, self._outgoing.wrote_s, keepalive_s):
            self.ping()
        self._loop.call_later(_MISC_S, self._look_after)

    # Called by paho, only while one of its loop functions runs, and so in the event loop's thread.

    def _on_socket_close(self, _client: Client, _userdata: Any, sock: Any) -> None:
        if sock.fileno() < 0:  # `close` was faster than paho
            return
        self._loop.remove_reader(sock)
        self._loop.remove_writer(sock)

    def _on_connect(self, _client: Client, _userdata: Any, _flags: Any, code: Any, properties: Any) -> None:
        self._outgoing.accepted(properties)
        _resolve(self._accepted, code.value)

    def _on_disconnect(self, _client: Client, _userdata: Any, _flags: Any, code: Any, _properties: Any) -> None:
        _resolve(self._accepted, code.value or 0x80)
        _resolve(self.ended, code.value)

    def _on_subscribe(self, _client: Client, _userdata: Any, mid: int, codes: Any, _properties: Any) -> None:
        self._incoming.note(self._subscriptions.on_suback, mid, [code.value for code in codes])

    def _refused(self, topic: str, code: int, for_good: bool) -> None:
        """A filter was refused: for good, which ends the link, or this time, which leads to a new connection."""
        self.refusal = f"the subscription to {topic} was refused with reason code 0x{code:02x}"
        if self.ended.done():
            return
        if for_good:
            logger.error("%s: %s: %s", self.name, self.address, self.refusal)
            self.ended.set_exception(BrokerRefused(f"{self.name}: {self.address} refused the subscription to {topic}"))
        else:
            self.give_up(self.refusal)


def _resolve(future: asyncio.Future[int], value: int) -> None:
    if not future.done():
        future.set_result(value)
