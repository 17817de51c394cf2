"""The gateway as a job of the activator: its UDP socket, and a connection to the fog's broker for each client."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable, Hashable
from math import inf
from typing import TYPE_CHECKING, Any, cast

from ....errors import BrokerRefused, ConfigurationError
from ...address import BrokerAddress
from ...effects import Inbound, Publish, Subscribe, Unsubscribe, Will
from ..connection import Connection
from ..tls import client_context
from .air_client import AirClient
from .gateway import Address, AirGateway
from .packets import CONGESTION
from .together import AirMessage
from .topic_ids import TopicIds

if TYPE_CHECKING:
    from ....security.identity import Identity

logger = logging.getLogger("mqttxt.mqtt")

BROKER_SIDE = "air"
CLIENT_PREFIX = "sn-"
"""Prefix of a client's id at the broker, so that no datagram takes over the id of a client with its own connection."""
MOST_UNSENT_BYTES = 1 << 20
TICK_S = 0.05
"""Half of the shortest time after which a packet is repeated."""
_LARGEST_DATAGRAM = 65_535
_TAKEN_AT_ONCE = 64
"""Datagrams read in a turn of the event loop. asyncio reads one, and of a broker 256 packets are read in a turn."""


class _ToBroker:
    """The connection of one client to the broker (`air_client.BrokerSide`)."""

    def __init__(self, air: Air, client: Callable[[], AirClient]) -> None:
        self._air = air
        self._client = client
        self._task: asyncio.Task[None] | None = None
        self._connection: Connection | None = None
        self._with_will = True

    def open(self, client_id: str, will: Will | None) -> None:
        self._task = asyncio.get_running_loop().create_task(self._run(client_id, will))
        self._air.tasks.add(self._task)
        self._task.add_done_callback(self._air.tasks.discard)

    def publish(self, told: AirMessage, ref: Hashable) -> None:
        if self._connection is not None:
            publish = Publish(BROKER_SIDE, told.topic, told.payload, told.qos, told.retain, ref=ref)
            code = self._connection.publish(publish)
            if code:
                self._client().on_published(ref, code)

    def subscribe(self, topic: str, live_only: bool, ref: Hashable) -> None:
        if self._connection is not None:
            self._connection.subscribe(Subscribe(BROKER_SIDE, (topic,), live_only, ref))

    def unsubscribe(self, topic: str) -> None:
        if self._connection is not None:
            self._connection.unsubscribe(Unsubscribe(BROKER_SIDE, (topic,)))

    def close(self, *, with_will: bool) -> None:
        self._with_will = with_will
        if self._task is not None:
            self._task.cancel()

    async def _run(self, client_id: str, will: Will | None) -> None:
        air, client = self._air, self._client()
        connection: Connection | None = None
        try:
            try:
                context = client_context(air.identity) if air.identity is not None else None
                connection = Connection(
                    BROKER_SIDE, air.broker, CLIENT_PREFIX + client_id, will, events=self, ssl_context=context
                )
                code = await connection.open()
            except (OSError, TimeoutError) as error:
                air.count("air_broker", f"{air.broker}: {error or 'no answer in time'}")
                code = CONGESTION
            if code == 0:
                self._connection = connection
            client.on_opened(code, air.now_s())
            air.look()
            if code == 0 and connection is not None:
                logger.info("%s: %s is connected", BROKER_SIDE, client_id)
                client.on_ended(air.now_s(), await _is_refused(connection))
        finally:
            self._connection = None
            if connection is not None:
                connection.close(with_will=self._with_will)
            air.look()

    # Reports of the connection.

    def connected(self, link: str) -> None:
        """Reported by links, not by connections."""

    def disconnected(self, link: str) -> None:
        """Reported by links, not by connections."""

    def received(self, link: str, message: Inbound) -> None:
        self._client().on_message(message, self._air.now_s())
        self._air.look()

    def subscribed(self, subscribe: Subscribe) -> None:
        self._client().on_subscribed(subscribe.ref)

    def published(self, link: str, ref: Hashable, code: int) -> None:
        self._client().on_published(ref, code)

    def count(self, kind: str, detail: str) -> None:
        self._air.count(kind, detail)


async def _is_refused(connection: Connection) -> bool:
    """Wait for a connection's end; returns whether it ended because a subscription was refused for good."""
    try:
        await connection.ended
    except BrokerRefused:
        return True
    return False


class Air(asyncio.DatagramProtocol):
    """Serves UAV clients at a UDP address, and connects each to `broker`. `root` is the root of the fog's topics."""

    def __init__(
        self,
        host: str,
        port: int,
        broker: BrokerAddress,
        root: str,
        count: Callable[[str, str], None],
        identity: Identity | None = None,
    ) -> None:
        self.host = host
        self.port = port
        self.broker = broker
        self.count = count
        self.tasks: set[asyncio.Task[None]] = set()
        self.identity = identity
        self._gateway = AirGateway(
            TopicIds(root), self._send, lambda client: _ToBroker(self, client), count, self._is_newer_list
        )
        self._transport: asyncio.DatagramTransport | None = None
        self._socket: socket.socket | None = None
        self._timer: asyncio.TimerHandle | None = None

    async def run(self) -> None:
        """Serve until cancelled; raises ConfigurationError if the address is not available."""
        loop = asyncio.get_running_loop()
        try:
            transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=(self.host, self.port))
        except OSError as error:
            raise ConfigurationError(
                f"--air-sn {self.host}:{self.port}: {error.strerror or error}; expected a free UDP port of this machine"
            ) from error
        logger.info("air: MQTT-SN at %s:%d", self.host, self.port)
        try:
            await loop.create_future()
        finally:
            self._gateway.end(self.now_s())
            transport.close()
            if self._socket is not None:
                self._socket.close()
                self._socket = None
            if self._timer is not None:
                self._timer.cancel()
            left = list(self.tasks)
            if left:
                await asyncio.wait(left)

    def now_s(self) -> float:
        return asyncio.get_running_loop().time()

    def look(self) -> None:
        """Start the timer if the gateway has clients and no timer runs.

        It ticks at a fixed interval: to ask each of 300 clients for its next time costs more than a datagram.
        """
        if self._timer is None and self._transport is not None and self._gateway.due_s() < inf:
            self._timer = asyncio.get_running_loop().call_later(TICK_S, self._tick)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.DatagramTransport", transport)
        self._socket = socket.socket(fileno=socket.dup(transport.get_extra_info("socket").fileno()))
        self._socket.setblocking(False)

    def connection_lost(self, error: Exception | None) -> None:
        self._transport = None

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._gateway.received(data, addr, self.now_s())
        self._take_more(_TAKEN_AT_ONCE - 1)
        self.look()

    def error_received(self, error: Exception) -> None:
        """The system refused a datagram: it is counted, and lost as if on the way."""
        self.count("air_send", str(error))

    def _take_more(self, most: int) -> None:
        """Take datagrams that have come meanwhile."""
        try:
            for _ in range(most):
                if self._socket is None:
                    break
                self._gateway.received(*self._socket.recvfrom(_LARGEST_DATAGRAM), self.now_s())
        except BlockingIOError:
            pass
        except OSError as error:
            self.error_received(error)

    def _is_newer_list(self, payload: bytes) -> bool:
        """Whether a payload is a revocation list of the fleet that is newer than the activator's."""
        if self.identity is None:
            return False
        fleet = self.identity.fleet
        try:
            return fleet.read(payload).number > fleet.revoked.number
        except ConfigurationError:
            return False

    def _send(self, datagram: bytes, address: Address) -> None:
        if self._transport is None:
            return
        waiting: int = cast("Any", self._transport).get_write_buffer_size()  # typeshed has it for streams alone
        if waiting > MOST_UNSENT_BYTES:
            self.count("air_send", "the system takes no more datagrams")
            return
        self._transport.sendto(datagram, address)

    def _tick(self) -> None:
        self._timer = None
        self._gateway.tick(self.now_s())
        self.look()
