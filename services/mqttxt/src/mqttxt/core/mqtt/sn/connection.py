"""A UAV client's connection to the gateway of its activator: the state machine `SnClient` on a UDP socket.

It has the methods of `..connection.Connection` that a link uses.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections import deque
from collections.abc import Callable
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any

from ...address import BrokerAddress
from ...effects import Inbound, Publish, Receipt, Subscribe, Unsubscribe, Will
from ..client import CONNECT_TIMEOUT_S, in_own_thread
from ..events import LinkEvents
from .client import SnClient
from .topic_ids import TopicIds

if TYPE_CHECKING:
    from ....security.identity import Identity

logger = logging.getLogger("mqttxt.mqtt")

_LARGEST_DATAGRAM = 65_535
_TAKEN_AT_ONCE = 256


class SnConnection:
    """One client, on a socket of its own: late datagrams of an earlier connection have another port.

    The link's number of `failures` chooses which of the addresses of the gateway's name is tried first.
    """

    def __init__(
        self,
        name: str,
        address: BrokerAddress,
        client_id: str,
        will: Will | None,
        events: LinkEvents,
        ids: TopicIds,
        failures: int = 0,
    ) -> None:
        self.name = name
        self.address = address
        self.refusal: str | None = None
        """Why this connection was given up although the gateway had accepted it."""
        self._failures = failures
        self.was_served = False
        """Whether the gateway has delivered or acknowledged a message."""
        self._events = events
        self._loop = asyncio.get_running_loop()
        self.ended: asyncio.Future[int] = self._loop.create_future()
        """Done, with 0, at the connection's end."""
        self._accepted: asyncio.Future[int] = self._loop.create_future()
        self._settled: asyncio.Future[None] | None = None
        self._notes: deque[Callable[[], None]] = deque()
        self._client = SnClient(client_id, will, ids, self._send, self)
        self._socket: socket.socket | None = None
        self._timer: asyncio.TimerHandle | None = None

    async def open(self) -> int:
        """Connect; returns the CONNACK's return code. Raises OSError, TimeoutError without a CONNACK."""
        connecting = in_own_thread(partial(_socket_to, self.address, self._failures))
        try:
            self._socket = await asyncio.shield(connecting)
        except asyncio.CancelledError:
            connecting.add_done_callback(_abandon)
            raise
        self._loop.add_reader(self._socket, self._readable)
        self._client.connect(self._loop.time())
        self._arm()
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            return await asyncio.shield(self._accepted)

    def publish(self, effect: Publish) -> None:
        """Send a message; with a `ref` its reason code is reported."""
        done = None if effect.ref is None else partial(self._published, effect)
        self._client.publish(effect, self._loop.time(), done)
        self._arm()

    def subscribe(self, effect: Subscribe) -> None:
        """Subscribe once the packets before it are answered."""
        self._client.subscribe(effect, self._loop.time(), partial(self._subscribed, effect))
        self._arm()

    def unsubscribe(self, effect: Unsubscribe) -> None:
        self._client.unsubscribe(effect.filters, self._loop.time())
        self._arm()

    def acknowledge(self, receipt: Receipt) -> None:
        """Does nothing: every message is acknowledged on arrival."""

    def ping(self) -> None:
        """Send a PINGREQ, unless one is unanswered."""
        self._client.ping(self._loop.time())
        self._arm()

    def usual_s(self) -> float:
        """The usual upper bound of the gateway's round trip, s; infinite if an answer is overdue."""
        return self._client.usual_s(self._loop.time())

    def wrong_with_broker(self, identity: Identity) -> str | None:
        """Always None: a gateway shows no certificate; the messages that it passes on are signed."""
        return None

    def give_up(self, reason: str) -> None:
        """End a connection that the gateway had accepted; the link then opens a new one."""
        self.refusal = reason
        self.close(with_will=True)

    async def settled(self, limit_s: float) -> None:
        """Wait, at most `limit_s`, until all messages that must arrive are acknowledged."""
        self._settled = self._loop.create_future()
        self._arm()
        awaited: set[asyncio.Future[Any]] = {self._settled, self.ended}
        await asyncio.wait(awaited, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)

    async def leave(self, limit_s: float) -> None:
        """Send DISCONNECT, repeated until answered, for at most `limit_s`; with the will if a message never arrived."""
        if self._socket is not None and not self.ended.done():
            self._client.disconnect(self._loop.time(), with_will=not self._client.is_settled)
            self._arm()
            await asyncio.wait({self.ended}, timeout=limit_s)
        self._end()

    def close(self, *, with_will: bool = False) -> None:
        """Send DISCONNECT once, and close the socket; if it is lost, the gateway notices the silence."""
        if self._socket is not None and not self._client.has_ended:
            self._client.disconnect(self._loop.time(), with_will=with_will or not self._client.is_settled)
        self._end()

    # Called by the state machine.

    def on_connack(self, code: int) -> None:
        if not self._accepted.done():
            self._accepted.set_result(code)

    def on_message(self, message: Inbound) -> None:
        self.was_served = True
        self._notes.append(partial(self._events.received, self.name, message))

    def on_ended(self) -> None:
        self._notes.append(self._end)

    def count(self, kind: str, detail: str) -> None:
        self._events.count(kind, f"{self.name}: {detail}")

    # Called by the event loop.

    def _readable(self) -> None:
        for _ in range(_TAKEN_AT_ONCE):
            sock = self._socket
            if sock is None:
                break
            try:
                datagram = sock.recv(_LARGEST_DATAGRAM)
            except BlockingIOError:
                break
            except OSError as error:
                self._failed(error)
                break
            self._client.received(datagram, self._loop.time())
        self._deliver()

    def _deliver(self) -> None:
        """Make the noted calls, now that the state machine is not half-way through a packet."""
        try:
            while self._notes:
                self._notes.popleft()()
        finally:
            if self._notes:  # a role failed: the loop reports it, and the rest is still delivered
                self._loop.call_soon(self._deliver)
            self._arm()

    def _arm(self) -> None:
        """Set the timer for the state machine's next `tick`."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._settled is not None and not self._settled.done() and self._client.is_settled:
            self._settled.set_result(None)
        due_s = self._client.due_s()
        if self._socket is not None and due_s < inf:
            self._timer = self._loop.call_at(due_s, self._tick)

    def _tick(self) -> None:
        self._timer = None
        self._client.tick(self._loop.time())
        self._deliver()

    def _send(self, datagram: bytes) -> None:
        """Send a datagram; one that the system refuses is counted, and lost as if on the way."""
        if self._socket is None:
            return
        try:
            self._socket.send(datagram)
        except ConnectionRefusedError as error:
            self._loop.call_soon(self._failed, error)
        except OSError as error:
            self.count("air_send", str(error.strerror or error))

    def _failed(self, error: OSError) -> None:
        """End after a socket error: no program listens at the gateway's port, for example."""
        if not self._accepted.done():
            self._accepted.set_exception(error)
        self._end()

    def _published(self, effect: Publish, code: int) -> None:
        self.was_served = True
        self._notes.append(partial(self._events.published, self.name, effect.ref, code))

    def _subscribed(self, effect: Subscribe, codes: list[int]) -> None:
        refused = [(topic, code) for topic, code in zip(effect.filters, codes, strict=True) if code != 0]
        if not refused:
            self._notes.append(partial(self._events.subscribed, effect))
            return
        topic, code = refused[0]
        refusal = f"the subscription to {topic} was refused with return code 0x{code:02x}"
        self._notes.append(partial(self.give_up, refusal))

    def _end(self) -> None:
        sock, self._socket = self._socket, None
        if sock is not None:
            self._loop.remove_reader(sock)
            sock.close()
        self._arm()
        if not self.ended.done():
            self.ended.set_result(0)
        if not self._accepted.done():
            self._accepted.set_exception(ConnectionResetError("connection closed"))
            self._accepted.exception()  # no caller may be waiting any more


def _socket_to(address: BrokerAddress, failures: int) -> socket.socket:
    """A UDP socket connected to the gateway; blocks while the name is resolved. Raises OSError."""
    found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
    first = failures % len(found)
    failure = OSError(f"{address.host}: no address")
    for family, kind, proto, _, where in found[first:] + found[:first]:
        try:
            sock = socket.socket(family, kind, proto)
        except OSError as error:
            failure = error
            continue
        try:
            sock.setblocking(False)
            sock.connect(where)
        except OSError as error:
            sock.close()
            failure = error
        else:
            return sock
    raise failure


def _abandon(connecting: asyncio.Future[socket.socket]) -> None:
    """Close a socket whose `open` was cancelled."""
    if connecting.exception() is None:
        connecting.result().close()
