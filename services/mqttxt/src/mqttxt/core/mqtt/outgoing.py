"""Writes to a broker in bulk; messages, of which there may be thousands per second, bypass paho."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Hashable
from itertools import count
from typing import TYPE_CHECKING, cast

from paho.mqtt.client import Client

from ..address import BrokerAddress
from ..effects import Publish
from .aliases import AliasTable
from .events import LinkEvents
from .packets import publish
from .properties import BrokerLimits

if TYPE_CHECKING:
    from .buffered import Buffered

TOO_LONG, TOO_MUCH = 0x95, 0x97
"""Reason codes of messages that are dropped (MQTT 5.0, 2.4): packet too large, quota exceeded."""
MOST_HELD = 10_000
"""How many publishes wait while the broker reads nothing or, at QoS 1, acknowledges nothing; others are dropped."""
_OWN_MIDS = range(0x8000, 0x10000)
"""Packet ids of publishes; paho numbers its few SUBSCRIBEs and UNSUBSCRIBEs from 1."""
_MOST_OWED = 2000
"""More than a broker may send without reading: the Receive Maximum, and an answer to each of our own publishes."""


class Outgoing:
    """The sending side of one connection, within the limits of the broker's CONNACK (`accepted`).

    `failed` is called when a write fails.
    """

    def __init__(
        self, name: str, address: BrokerAddress, client: Client, events: LinkEvents, failed: Callable[[], object]
    ) -> None:
        self.wrote_s = 0.0
        """Time of the last write, in seconds of the event loop's clock."""
        self._name = name
        self._address = address
        self._client = client
        self._socket = cast("Callable[[], Buffered | None]", client.socket)
        self._events = events
        self._failed = failed
        self._loop = asyncio.get_running_loop()
        self._limits, self._aliases = BrokerLimits(), AliasTable(0)
        self._refs: dict[int, Hashable] = {}
        self._unacknowledged: dict[int, None] = {}
        self._serials = count()
        self._waiting: deque[Publish] = deque()
        self._settled: asyncio.Future[None] | None = None
        self._flush_is_due = self._is_blocked = False
        self._held = self._owed = 0

    @property
    def sock(self) -> Buffered | None:
        """The socket; None if it is closed."""
        return self._socket()

    @property
    def has_waiting(self) -> bool:
        """Whether messages wait because earlier ones are not acknowledged."""
        return bool(self._waiting)

    @property
    def oldest(self) -> int | None:
        """The packet id of the first publish that is not acknowledged."""
        return next(iter(self._unacknowledged), None)

    def accepted(self, connack: object) -> None:
        self._limits = BrokerLimits.of(connack)
        self._aliases = AliasTable(self._limits.aliases)

    def publish(self, effect: Publish) -> int:
        """Send a message; all messages of one turn of the event loop are written together.

        Returns 0, or, if the message is counted and dropped, TOO_MUCH or TOO_LONG.
        """
        if self._is_blocked and effect.qos == 0:
            if self._held >= MOST_HELD:
                self._events.count("held_up", f"{self._name}: {effect.topic}: {self._address} takes no bytes")
                return TOO_MUCH
            self._held += 1
        if not self._limits.fits(effect.topic, effect.payload):
            detail = f"{effect.topic}: {self._address} takes packets of at most {self._limits.largest_packet} bytes"
            self._events.count("too_long_for_broker", detail)
            return TOO_LONG
        if effect.qos > 0 and len(self._unacknowledged) >= self._limits.in_flight:
            if len(self._waiting) < MOST_HELD:
                self._waiting.append(effect)
                return 0
            self._events.count("held_up", f"{self._name}: {effect.topic}: {self._address} acknowledges nothing")
            return TOO_MUCH
        if self._client.want_write():  # paho's own unwritten packets come first
            self._client.loop_write()
        sock = self._socket()
        if sock is None:
            return 0
        if effect.qos == 0:
            sock.send(publish(effect, *self._aliases.shorten(effect.topic)))
        else:
            mid = self._unused_mid()
            sock.send(publish(effect, effect.topic, None, mid))
            self._unacknowledged[mid] = None
            if effect.ref is not None:
                self._refs[mid] = effect.ref
        self.flush_soon()
        return 0

    def _unused_mid(self) -> int:
        """The next packet id that no unacknowledged message has."""
        mids = (_OWN_MIDS[serial % len(_OWN_MIDS)] for serial in self._serials)
        return next(mid for mid in mids if mid not in self._unacknowledged)

    def send(self, packet: bytes) -> None:
        """Send a packet, bypassing paho."""
        sock = self.sock
        if sock is not None:
            sock.send(packet)
            self.flush_soon()

    def on_puback(self, mid: int, code: int) -> None:
        """A publish was acknowledged, or refused, with a reason code: send the next waiting message, and report it."""
        if mid not in self._unacknowledged:
            return
        del self._unacknowledged[mid]
        ref = self._refs.pop(mid, None)
        if self._waiting and self.sock is not None:
            self.publish(self._waiting.popleft())
        self._check_settled()
        if ref is not None:
            self._events.published(self._name, ref, code)

    def owe_an_answer(self) -> None:
        """Count an answer for a broker that reads nothing; raises ValueError after too many of them."""
        self._owed += self._is_blocked
        if self._owed > _MOST_OWED:
            raise ValueError(f"{self._owed} packets, without reading the answers")

    def flush_soon(self) -> None:
        """Write pending bytes at the end of this turn of the event loop, or when the system accepts bytes again."""
        if not self._flush_is_due and not self._is_blocked:
            self._flush_is_due = True
            self._loop.call_soon(self.flush)

    def flush(self) -> None:
        """Write pending bytes; those that the system does not accept follow when it does."""
        self._flush_is_due = False
        if self.sock is not None:
            self._client.loop_write()
        sock = self.sock
        if sock is None:
            return
        has_left = sock.flush()
        self.wrote_s = self._loop.time()
        if not has_left and not self._is_blocked:
            self._is_blocked = True
            self._loop.add_writer(sock, self.flush)
        elif has_left and self._is_blocked:
            self._is_blocked, self._held, self._owed = False, 0, 0
            self._loop.remove_writer(sock)
        if sock.failure is not None:
            self._failed()
        elif has_left:
            self._check_settled()

    def settled(self) -> asyncio.Future[None]:
        """A future that is done once every message is written and, at QoS 1, acknowledged."""
        self.flush()
        self._settled = self._loop.create_future()
        self._check_settled()
        return self._settled

    def _check_settled(self) -> None:
        has_left = not self._client.want_write() and not self._is_blocked
        if self._settled is not None and not self._settled.done() and not self._unacknowledged and has_left:
            self._settled.set_result(None)
