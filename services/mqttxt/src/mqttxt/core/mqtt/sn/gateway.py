"""The activator's end of the air leg: the clients by address. A state machine that is fed datagrams and times."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Any

from ....protocol.cbor import MAX_PAYLOAD
from ...floods import TokenBucket
from ...shared_lists import LISTS_AT_ONCE, LISTS_PER_S
from . import codec, packets
from .air_client import AirClient, BrokerSide, Stage
from .sender import LARGEST_DATAGRAM
from .topic_ids import TopicIds

MOST_CLIENTS = 300
"""More than the 250 drones that a fog may have."""
CLIENT_PER_S, CLIENT_AT_ONCE = 1000, 2000
"""Limits for one client: its datagrams, or their messages if a datagram has several."""
STRANGERS_PER_S, STRANGERS_AT_ONCE = 200, 400
"""Limits for the datagrams of all others together: their sender addresses may be forged."""

OPENED_PER_S, OPENED_AT_ONCE = 20, 60
"""Limits for new connections to the broker, for all clients together; at most `OPENED_AT_ONCE` are being opened."""

BIRTHS_PER_S, BIRTHS_AT_ONCE = 5, 20
"""Limits for births and wills of one drone, per 1,200 bytes or part of them: the drone receives forged ones too."""

Address = tuple[Any, ...]


class AirGateway:
    """All clients. `send` sends a datagram to an address; `broker` makes a client's connection to the broker.

    `is_newer_list` returns whether a payload is a revocation list of the fleet that is newer than the activator's;
    without an identity none is.
    """

    def __init__(
        self,
        ids: TopicIds,
        send: Callable[[bytes, Address], None],
        broker: Callable[[Callable[[], AirClient]], BrokerSide],
        count: Callable[[str, str], None],
        is_newer_list: Callable[[bytes], bool] = lambda _payload: False,
    ) -> None:
        self._ids = ids
        self._send = send
        self._broker = broker
        self._count = count
        self._is_newer_list = is_newer_list
        self._at: dict[Address, AirClient] = {}
        self._of_clients = TokenBucket(CLIENT_PER_S, CLIENT_AT_ONCE)
        self._of_strangers = TokenBucket(STRANGERS_PER_S, STRANGERS_AT_ONCE)
        self._of_openings = TokenBucket(OPENED_PER_S, OPENED_AT_ONCE)
        self._of_births = TokenBucket(BIRTHS_PER_S, BIRTHS_AT_ONCE)
        self._of_lists = TokenBucket(LISTS_PER_S, LISTS_AT_ONCE)

    def received(self, datagram: bytes, address: Address, now_s: float) -> None:
        """A datagram arrived; one that is no packet, or beyond the limits, is counted and dropped."""
        client, now_ms = self._at.get(address), int(now_s * 1000)
        budget, whose = (self._of_clients, address) if client is not None else (self._of_strangers, ())
        if not budget.takes(whose, now_ms):
            self._count("air_flood", f"{address[0]}:{address[1]}")
            return
        try:
            packet = _read(datagram)
        except ValueError as error:
            self._count("air_datagram", f"{address[0]}:{address[1]}: {error}")
            return
        if client is not None:
            client.came(len(datagram))
        if isinstance(packet, packets.Connect):
            self._on_connect(packet, len(datagram), address, now_s)
        elif client is not None:
            before = client.published
            client.received(packet, now_s)
            budget.owes(address, now_ms, max(0, client.published - before - 1))
            self._look_at(address, now_s)
        elif not isinstance(packet, packets.Disconnect):  # two gateways would go on answering each other
            self._send(codec.encode(packets.Disconnect()), address)

    def tick(self, now_s: float) -> None:
        """Repeat due packets, and end clients that are over; to be called at `due_s`."""
        for address in list(self._at):
            self._look_at(address, now_s)

    def due_s(self) -> float:
        """When to call `tick` next; infinite without clients."""
        return min((client.due_s() for client in self._at.values()), default=inf)

    def end(self, now_s: float) -> None:
        """End all clients."""
        for client in self._at.values():
            if client.is_there:
                client.end(now_s)

    def _on_connect(self, packet: packets.Connect, size: int, address: Address, now_s: float) -> None:
        known = self._at.get(address)
        if known is not None and known.client_id == packet.client_id and known.on_connect_again(now_s):
            return
        rival = next((one for one in self._at.values() if one.is_there and one.client_id == packet.client_id), None)
        if rival is not None:  # a CONNECT proves nothing: anyone can repeat one
            rival.ask(now_s)
            return
        if known is not None and known.is_there:
            known.ask(now_s)
            return
        if known is not None and known.stage is Stage.LEFT and not known.is_confirmed:
            return
        if known is None and len(self._at) >= MOST_CLIENTS:
            self._count("air_full", f"{address[0]}:{address[1]}: more than {MOST_CLIENTS} clients")
            self._send(codec.encode(packets.Connack(packets.CONGESTION)), address)
            return
        made: list[AirClient] = []
        broker = self._broker(lambda: made[0])
        client = AirClient(
            packet,
            self._ids,
            lambda datagram: self._send(datagram, address),
            broker,
            self._claim,
            self._passes_list,
            self._takes_birth,
            self._count,
            now_s,
        )
        made.append(client)
        self._at[address] = client
        client.came(size)
        client.start()
        self._look_at(address, now_s)

    def _claim(self, client: AirClient, now_s: float) -> bool:
        """Whether a client may connect: within the limits, with an id and a drone of its own.

        Another client with its id or drone is challenged.
        """
        for other in self._at.values():
            is_same = other.client_id == client.client_id or (client.drone is not None and other.drone == client.drone)
            if other is not client and other.is_there and is_same:
                other.ask(now_s)
                return False
        if client.stage is Stage.UP:
            return True
        under_way = sum(other.stage is Stage.OPENING for other in self._at.values() if other is not client)
        if under_way < OPENED_AT_ONCE and self._of_openings.takes((), int(now_s * 1000)):
            return True
        self._count("air_full", f"{client.client_id}: more than {OPENED_PER_S} connections a second to the broker")
        return False

    def _passes_list(self, payload: bytes, now_s: float) -> bool:
        """Whether to pass a client's revocation list to the broker; beyond the limit for all clients it is not read."""
        return self._of_lists.takes((), int(now_s * 1000)) and self._is_newer_list(payload)

    def _takes_birth(self, drone: int | None, size: int, now_s: float) -> bool:
        """Whether a birth or will is within its drone's limit, to which a long one counts several times."""
        now_ms = int(now_s * 1000)
        if not self._of_births.takes(drone, now_ms):
            return False
        self._of_births.owes(drone, now_ms, size // LARGEST_DATAGRAM)
        return True

    def _look_at(self, address: Address, now_s: float) -> None:
        client = self._at[address]
        client.tick(now_s)
        if client.stage is Stage.GONE:
            del self._at[address]


def _read(datagram: bytes) -> packets.Packet:
    """Decode a client's packet; raises ValueError if it is none, or longer than allowed."""
    is_will = datagram[3:4] == bytes((packets.WillMsg.KIND,))
    if len(datagram) > (codec.size_of_publish(b"") + MAX_PAYLOAD if is_will else LARGEST_DATAGRAM):
        raise ValueError(f"{len(datagram)} bytes; expected at most {LARGEST_DATAGRAM}")
    return codec.decode(datagram)
