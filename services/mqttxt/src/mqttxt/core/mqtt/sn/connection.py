"""A UAV client's connection to the gateway of its activator: the machine of `client` on a UDP socket.

It has the methods of `..connection.Connection`, which a link uses.
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
    """One client, on a socket of its own: what is late of an earlier connection has another sender's port.

    With each of the link's `failures` it begins with the next of the addresses that the gateway's name has.
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
        """Why this connection was given up though the gateway had accepted it."""
        self._failures = failures
        self.was_served = False
        """Whether the gateway has delivered or acknowledged a message."""
        self._events = events
        self._loop = asyncio.get_running_loop()
        self.ended: asyncio.Future[int] = self._loop.create_future()
        """0 at the connection's end."""
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
        """Hand a message over."""
        done = None if effect.ref is None else partial(self._published, effect)
        self._client.publish(effect, self._loop.time(), done)
        self._arm()

    def subscribe(self, effect: Subscribe) -> None:
        """Subscribe, behind what is under way."""
        self._client.subscribe(effect, self._loop.time(), partial(self._subscribed, effect))
        self._arm()

    def unsubscribe(self, effect: Unsubscribe) -> None:
        self._client.unsubscribe(effect.filters, self._loop.time())
        self._arm()

    def acknowledge(self, receipt: Receipt) -> None:
        """Nothing: all that comes is acknowledged at once."""

    def ping(self) -> None:
        """Ask the gateway for a sign of life, unless it owes one."""
        self._client.ping(self._loop.time())
        self._arm()

    def usual_s(self) -> float:
        """By when the gateway answers as a rule, in seconds; infinite where an answer is overdue."""
        return self._client.usual_s(self._loop.time())

    def wrong_with_broker(self, identity: Identity) -> str | None:
        """None: a gateway shows no certificate; what it passes on is signed."""
        return None

    def give_up(self, reason: str) -> None:
        """End a connection that the gateway had accepted; the link begins another one."""
        self.refusal = reason
        self.close(with_will=True)

    async def settled(self, limit_s: float) -> None:
        """Wait until all that has to arrive has."""
        self._settled = self._loop.create_future()
        self._arm()
        awaited: set[asyncio.Future[Any]] = {self._settled, self.ended}
        await asyncio.wait(awaited, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)

    async def leave(self, limit_s: float) -> None:
        """DISCONNECT, repeated until the gateway has answered; with the will where something never arrived."""
        if self._socket is not None and not self.ended.done():
            self._client.disconnect(self._loop.time(), with_will=not self._client.is_settled)
            self._arm()
            await asyncio.wait({self.ended}, timeout=limit_s)
        self._end()

    def close(self, *, with_will: bool = False) -> None:
        """DISCONNECT once, and close the socket; where that is lost, the gateway notices the silence."""
        if self._socket is not None and not self._client.has_ended:
            self._client.disconnect(self._loop.time(), with_will=with_will or not self._client.is_settled)
        self._end()

    # What the machine calls.

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

    # What the event loop calls.

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
        """Tell what was noted, now that the machine is not half-way through a packet."""
        try:
            while self._notes:
                self._notes.popleft()()
        finally:
            if self._notes:  # a role failed: the loop reports it, and the rest is delivered all the same
                self._loop.call_soon(self._deliver)
            self._arm()

    def _arm(self) -> None:
        """See to it that the machine is called when it has something to do."""
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
        """A datagram that the system does not take is lost, as on the way."""
        if self._socket is None:
            return
        try:
            self._socket.send(datagram)
        except ConnectionRefusedError as error:
            self._loop.call_soon(self._failed, error)
        except OSError as error:
            self.count("air_send", str(error.strerror or error))

    def _failed(self, error: OSError) -> None:
        """Nobody is at the gateway's port."""
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
            self._accepted.exception()  # nobody may wait for it any more


def _socket_to(address: BrokerAddress, failures: int) -> socket.socket:
    """A UDP socket whose other side the gateway is; blocks while the name is resolved. Raises OSError."""
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
    """Nobody waits for this socket any more."""
    if connecting.exception() is None:
        connecting.result().close()
