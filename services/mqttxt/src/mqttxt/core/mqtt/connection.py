"""One connection to a broker, from CONNECT to its end: paho-mqtt inside the event loop, without its thread.

Messages at QoS 0, of which there may be thousands a second, pass paho by. Its callbacks only take notes. What is noted
is delivered after paho has returned, so that a role may publish, and fail, without paho being half-way through a
packet.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import struct
from collections import deque
from collections.abc import Callable, Hashable
from itertools import count
from typing import TYPE_CHECKING, Any, cast

from paho.mqtt import MQTTException
from paho.mqtt.client import Client
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode

from ...errors import BrokerRefused
from ..address import BrokerAddress
from ..effects import Inbound, Publish, Receipt, Unsubscribe, Will
from .aliases import AliasTable, BrokersAliases
from .client import CONNECT_TIMEOUT_S, KEEPALIVE_S, make_client, start_connecting
from .events import LinkEvents
from .packets import KIND, PINGREQ, PINGRESP, PUBLISH, RETAIN, end_of, message_of, publish
from .properties import LARGEST_PACKET, BrokerLimits, expiry_properties
from .round_trip import RoundTrip
from .subscriptions import Subscriptions

if TYPE_CHECKING:
    from ...security.identity import Identity
    from .buffered import Buffered

logger = logging.getLogger("mqttxt.mqtt")

TOO_LONG, TOO_MUCH = 0x95, 0x97
"""Reason codes of what is not handed over (MQTT 5.0, 2.4): packet too large, quota exceeded."""
MOST_HELD = 10_000
"""Publishes that wait while the broker takes no bytes or, at QoS 1, acknowledges none; further ones are dropped."""
_MOST_OWED = 2000
"""Above what a broker may send without reading: the Receive Maximum, and an answer to each of our own publishes."""
_LONGEST_OTHER = 4096
"""Of packets that are no PUBLISH. paho reads these, and takes longer for each of their properties than for the last."""
_TAKEN_AT_ONCE = 256
_VOID_BYTES = 65_536
_SERIALS = count(1)
_MISC_S = 1.0
_WITH_WILL = ReasonCode(PacketTypes.DISCONNECT, "Disconnect with will message")
_UNPARSABLE = (struct.error, ValueError, LookupError, TypeError, MQTTException)
"""What paho raises, beside what it handles itself, on bytes that are not MQTT."""


class Connection:
    """One client. With `session_expiry_s` 0 its start is clean and its session ends with it.

    `aliases`: how many topics the broker may give aliases to.
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
        """The reason code of the connection's end, BrokerRefused where a subscription was refused."""
        self._accepted: asyncio.Future[int] = self._loop.create_future()
        self._notes: deque[tuple[Callable[..., None], tuple[Any, ...]]] = deque()
        self.refusal: str | None = None
        """Why this connection was given up though the broker had accepted it."""
        self.was_served = False
        """Whether the broker has delivered or acknowledged a message, or answered a ping."""
        self._refs: dict[int, Hashable] = {}
        self._unacknowledged: set[int] = set()
        self._waiting: deque[Publish] = deque()
        self._settled: asyncio.Future[int] | None = None
        self._aliases, self._theirs = AliasTable(0), BrokersAliases(aliases)
        self._limits = BrokerLimits()
        self._flush_is_due = self._is_blocked = self._take_is_due = False
        self._held = self._owed = 0
        self._last_in_s = self._last_out_s = 0.0
        self._pinged_s: float | None = None
        self._round_trip = RoundTrip()
        self._serial = next(_SERIALS) if manual_ack else None
        self._client = client = make_client(address, client_id, will, ssl_context)
        self._subscriptions = Subscriptions(client, events.subscribed, self._refused)
        self.subscribe = self._subscriptions.subscribe
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_subscribe = self._on_subscribe
        client.on_publish = self._on_publish

    async def open(self) -> int:
        """Connect; returns the CONNACK's reason code. Raises OSError, TimeoutError without a CONNACK."""
        # paho resolves, connects and shakes hands blocking: that is done in a thread, all else in this loop.
        connecting = start_connecting(self._client, self.address, self._session_expiry_s, self._theirs.maximum)
        try:
            await asyncio.shield(connecting)
        except asyncio.CancelledError:
            connecting.add_done_callback(self._abandon)
            raise
        sock = self._socket
        if sock is None:
            raise ConnectionResetError("connection closed")
        self._client.on_socket_register_write = lambda *_: self._flush_soon()
        self._client.on_socket_close = self._on_socket_close
        self._last_in_s = self._last_out_s = self._loop.time()
        self._loop.add_reader(sock, self._readable)
        self._loop.call_later(_MISC_S, self._look_after)
        self._flush()
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            return await asyncio.shield(self._accepted)

    def publish(self, effect: Publish) -> int:
        """Hand a message over; all that is handed over in one turn of the event loop leaves together.

        Returns 0; of a message that is counted and dropped, the reason code of what is too much, or too long.
        """
        if self._is_blocked and effect.qos == 0:
            if self._held >= MOST_HELD:
                self._events.count("held_up", f"{self.name}: {effect.topic}: {self.address} takes no bytes")
                return TOO_MUCH
            self._held += 1
        if not self._limits.fits(effect.topic, effect.payload):
            detail = f"{effect.topic}: {self.address} takes packets of at most {self._limits.largest_packet} bytes"
            self._events.count("too_long_for_broker", detail)
            return TOO_LONG
        if effect.qos > 0 and len(self._unacknowledged) >= self._limits.in_flight:
            if len(self._waiting) < MOST_HELD:
                self._waiting.append(effect)
                return 0
            self._events.count("held_up", f"{self.name}: {effect.topic}: {self.address} acknowledges nothing")
            return TOO_MUCH
        if effect.qos == 0:
            if self._socket is not None:
                if self._client.want_write():  # what paho has yet to write comes first
                    self._client.loop_write()
                self._socket.send(publish(effect, *self._aliases.shorten(effect.topic)))
                self._flush_soon()
            return 0
        info = self._client.publish(
            effect.topic, effect.payload, effect.qos, effect.retain, expiry_properties(effect.expiry_s)
        )
        if info.rc == MQTTErrorCode.MQTT_ERR_SUCCESS:
            self._unacknowledged.add(info.mid)
            if effect.ref is not None:
                self._refs[info.mid] = effect.ref
        return 0

    @property
    def _socket(self) -> Buffered | None:
        """None where it is closed."""
        return cast("Buffered | None", self._client.socket())

    def unsubscribe(self, effect: Unsubscribe) -> None:
        self._client.unsubscribe(list(effect.filters))

    def _acknowledge(self, mid: int, qos: int) -> None:
        """PUBACK, behind what a role does by the message: a command goes on before its sender's broker is answered."""
        if self._socket is not None:
            self._client.ack(mid, qos)

    def acknowledge(self, receipt: Receipt) -> None:
        """PUBACK for an inbound message, unless another connection received it. In the order of their receipt."""
        serial, mid = receipt
        if serial == self._serial:
            self._client.ack(mid, 1)

    def ping(self) -> None:
        """Ask the broker for a sign of life, unless it owes one."""
        if self._pinged_s is None and self._socket is not None:
            self._pinged_s = self._loop.time()
            self._socket.send(PINGREQ)
            self._flush_soon()

    def usual_s(self) -> float:
        """By when the broker answers as a rule, in seconds; infinite where an answer is overdue."""
        return self._round_trip.usual_s(self._loop.time() - self._pinged_s if self._pinged_s is not None else 0.0)

    def wrong_with_broker(self, identity: Identity) -> str | None:
        """Why the broker's certificate is not good now, in words; None while it is."""
        from .tls import wrong_with

        sock = self._socket.sock if self._socket is not None else None
        return wrong_with(identity, sock.getpeercert(binary_form=True)) if isinstance(sock, ssl.SSLSocket) else None

    def give_up(self, reason: str) -> None:
        """End a connection that the broker had accepted; the link begins another one."""
        self.refusal = reason
        self.close(with_will=True)

    async def settled(self, limit_s: float) -> None:
        """Wait until all that was handed over has left, and is acknowledged where that is asked for."""
        self._flush()
        self._settled = self._loop.create_future()
        self._check_settled()
        await asyncio.wait({self._settled, self.ended}, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)

    def close(self, *, with_will: bool = False) -> None:
        """DISCONNECT behind what was handed over, as far as the system takes it now; then close the socket.

        The broker publishes the will where that is asked for, and where something of what was handed over never left
        because the broker acknowledges too little: the last word is the last of it.
        """
        reason = _WITH_WILL if with_will or self._waiting else None
        if self._client.disconnect(reason) == MQTTErrorCode.MQTT_ERR_SUCCESS:
            self._flush()
        sock = self._socket
        if sock is not None:  # paho has not done it
            self._on_socket_close(self._client, None, sock)
            sock.close()
        _resolve(self.ended, 0)

    async def leave(self, limit_s: float) -> None:
        """`close`, and then read what still comes, into the void, until the broker has closed too.

        A socket that is closed over unread bytes is reset at once (RFC 2525, section 2.17): the DISCONNECT behind what
        was handed over would be lost, and the broker would publish the will of a client that stopped cleanly.
        """
        sock = self._socket
        if sock is None:
            self.close()
            return
        with socket.socket(fileno=socket.dup(sock.fileno())) as rest:
            self.close()
            rest.setblocking(False)
            with contextlib.suppress(OSError):  # reset all the same, or not closed in time
                rest.shutdown(socket.SHUT_WR)
                async with asyncio.timeout(limit_s):
                    while await self._loop.sock_recv(rest, _VOID_BYTES):
                        pass

    def _abandon(self, connecting: asyncio.Future[None]) -> None:
        """Nobody waits for this connection any more; it came about, or not."""
        connecting.exception()
        self.close()

    # What the event loop calls.

    def _readable(self) -> None:
        """Read what is there, and take it."""
        sock = self._socket
        if sock is not None and not self._take_is_due:
            if sock.fetch():
                self._last_in_s = self._loop.time()
            self._take()

    def _take(self) -> None:
        """Take what has come, up to a number of packets, and deliver what it was; the rest in the next turn."""
        self._take_is_due = False
        for _ in range(_TAKEN_AT_ONCE):
            sock = self._socket
            if sock is None:
                break
            try:
                if not self._take_packet(sock):
                    break
            except _UNPARSABLE as error:
                logger.error("%s: %s sent what is not MQTT: %s", self.name, self.address, error)
                self.close(with_will=True)
                break
        else:
            self._take_is_due = True
        try:
            while self._notes:
                act, args = self._notes.popleft()
                act(*args)
        finally:
            if self._notes:  # a role failed: the loop reports it, and the rest is delivered all the same
                self._take_is_due = True
            if self._take_is_due:
                self._loop.call_soon(self._take)

    def _take_packet(self, sock: Buffered) -> bool:
        """Take the first packet of what has come; False where none is whole."""
        came, start = sock.came, sock.start
        body, end = end_of(came, start)
        if end - start > LARGEST_PACKET:
            raise ValueError(f"a packet of {end - start} bytes; expected at most {LARGEST_PACKET}")
        if end == 0 or end > len(came):
            if sock.failure is not None:
                sock.is_over = True
                self._client.loop_read()
            return False
        sock.start = end
        if came[start] & KIND == PUBLISH:
            self.was_served = True
            self._take_message(came, start, body, end)
        elif came[start] == PINGRESP:
            self.was_served = True
            if self._pinged_s is not None:
                self._round_trip.took(self._loop.time() - self._pinged_s)
            self._pinged_s = None
        elif end - start > _LONGEST_OTHER:
            raise ValueError(f"{end - start} bytes that are no PUBLISH; expected at most {_LONGEST_OTHER}")
        else:
            self._owe_an_answer()
            sock.for_paho = came[start:end]
            self._client.loop_read()
        return True

    def _take_message(self, came: bytes, start: int, body: int, end: int) -> None:
        name, payload, qos, mid = message_of(came, start, body, end, self._theirs)
        receipt = (self._serial, mid) if self._serial is not None and qos else None
        try:
            message = Inbound(name.decode(), payload, qos, came[start] & RETAIN != 0, receipt)
        except UnicodeDecodeError:
            receipt = None
            self._note(self._events.count, "topic", f"{self.name}: a topic that is not UTF-8")
        else:
            self._note(self._events.received, self.name, message)
        if qos:
            self._owe_an_answer()
            if receipt is None:
                self._note(self._acknowledge, mid, qos)

    def _owe_an_answer(self) -> None:
        """Raises ValueError for a broker that goes on asking for answers and does not read them."""
        self._owed += self._is_blocked
        if self._owed > _MOST_OWED:
            raise ValueError(f"{self._owed} packets, without reading the answers")

    def _flush_soon(self) -> None:
        """Write what was handed over when this turn of the event loop is over, or when the system takes bytes again."""
        if not self._flush_is_due and not self._is_blocked:
            self._flush_is_due = True
            self._loop.call_soon(self._flush)

    def _flush(self) -> None:
        """Write what waits; where the system does not take all, the rest when it does."""
        self._flush_is_due = False
        if self._socket is not None:
            self._client.loop_write()
        sock = self._socket
        if sock is None:
            return
        has_left = sock.flush()
        self._last_out_s = self._loop.time()
        if not has_left and not self._is_blocked:
            self._is_blocked = True
            self._loop.add_writer(sock, self._flush)
        elif has_left and self._is_blocked:
            self._is_blocked, self._held, self._owed = False, 0, 0
            self._loop.remove_writer(sock)
        if sock.failure is not None:
            self._loop.call_soon(self._take)
        elif has_left:
            self._check_settled()

    def _look_after(self) -> None:
        """Keep-alive: ask a broker that was not spoken to, or said nothing; give it up where it does not answer."""
        sock, now_s = self._socket, self._loop.time()
        if self.ended.done() or sock is None:
            return
        # A broker may ask for less patience, not for more.
        keepalive_s = min(self._client.keepalive or KEEPALIVE_S, KEEPALIVE_S)
        if self._pinged_s is not None and now_s - self._pinged_s >= keepalive_s:
            logger.info("%s: %s does not answer", self.name, self.address)
            self.close(with_will=True)
            return
        quiet_s = now_s - min(self._last_in_s, self._last_out_s)
        if self._pinged_s is None and quiet_s >= keepalive_s:
            self.ping()
        self._loop.call_later(_MISC_S, self._look_after)

    # What paho calls. Only while one of its loop functions runs, so in the event loop's thread.

    def _on_socket_close(self, _client: Client, _userdata: Any, sock: Any) -> None:
        if sock.fileno() < 0:  # `close` was faster than paho
            return
        self._loop.remove_reader(sock)
        self._loop.remove_writer(sock)

    def _on_connect(self, _client: Client, _userdata: Any, _flags: Any, code: Any, properties: Any) -> None:
        self._limits = BrokerLimits.of(properties)
        self._aliases = AliasTable(self._limits.aliases)
        _resolve(self._accepted, code.value)

    def _on_disconnect(self, _client: Client, _userdata: Any, _flags: Any, code: Any, _properties: Any) -> None:
        _resolve(self._accepted, code.value or 0x80)
        _resolve(self.ended, code.value)

    def _on_subscribe(self, _client: Client, _userdata: Any, mid: int, codes: Any, _properties: Any) -> None:
        self._note(self._subscriptions.on_suback, mid, [code.value for code in codes])

    def _on_publish(self, _client: Client, _userdata: Any, mid: int, code: Any, _properties: Any) -> None:
        self.was_served = True
        self._unacknowledged.discard(mid)
        if mid in self._refs:
            self._note(self._events.published, self.name, self._refs.pop(mid), code.value)
        self._note(self._go_on)

    def _note(self, act: Callable[..., None], *args: Any) -> None:
        self._notes.append((act, args))

    def _go_on(self) -> None:
        """A publish was acknowledged: room for one that waits."""
        if self._waiting and not self.ended.done():
            self.publish(self._waiting.popleft())
        self._check_settled()

    def _check_settled(self) -> None:
        has_left = not self._client.want_write() and not self._is_blocked
        if self._settled is not None and not self._unacknowledged and has_left:
            _resolve(self._settled, 0)

    def _refused(self, topic: str, code: int, for_good: bool) -> None:
        """A filter was not granted: for good, or only this time, and then all begins anew on a new connection."""
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
