"""Reads a broker's bytes in bulk: messages bypass paho, and everything is delivered once paho has returned."""

from __future__ import annotations

import asyncio
import logging
import struct
from collections import deque
from collections.abc import Callable
from itertools import count
from typing import Any

from paho.mqtt import MQTTException
from paho.mqtt.client import Client

from ..address import BrokerAddress
from ..effects import Inbound, Receipt
from .aliases import BrokersAliases
from .buffered import Buffered
from .events import LinkEvents
from .keep_alive import KeepAlive
from .outgoing import Outgoing
from .packets import KIND, PINGRESP, PUBACK, PUBLISH, RETAIN, acknowledged, end_of, message_of, puback
from .properties import LARGEST_PACKET

logger = logging.getLogger("mqttxt.mqtt")

_LONGEST_OTHER = 4096
"""Bytes of a packet other than PUBLISH; paho parses most of these, and takes longer for each further property."""
_TAKEN_AT_ONCE = 256
_SERIALS = count(1)
_UNPARSABLE = (struct.error, ValueError, LookupError, TypeError, MQTTException)
"""Errors that paho raises, besides those it handles itself, on bytes that are not MQTT."""


class Incoming:
    """The receiving side of one connection; `broken` is called if the broker sends bytes that are not MQTT.

    With `manual_ack` a message at QoS 1 has a receipt, and its PUBACK waits for `acknowledge`.
    """

    def __init__(
        self,
        name: str,
        address: BrokerAddress,
        client: Client,
        events: LinkEvents,
        outgoing: Outgoing,
        keep_alive: KeepAlive,
        aliases: BrokersAliases,
        manual_ack: bool,
        broken: Callable[[], None],
    ) -> None:
        self.was_served = False
        """Whether the broker has delivered or acknowledged a message, or answered a ping."""
        self._name = name
        self._address = address
        self._client = client
        self._events = events
        self._outgoing = outgoing
        self._keep_alive = keep_alive
        self._aliases = aliases
        self._serial = next(_SERIALS) if manual_ack else None
        self._broken = broken
        self._loop = asyncio.get_running_loop()
        self._notes: deque[tuple[Callable[..., None], tuple[Any, ...]]] = deque()
        self._take_is_due = False

    def readable(self) -> None:
        """Read the available bytes and process them."""
        sock = self._outgoing.sock
        if sock is not None and not self._take_is_due:
            if sock.fetch():
                self._keep_alive.heard_s = self._loop.time()
            self.take()

    def take(self) -> None:
        """Process a bounded number of received packets and deliver them; the rest follows in the loop's next turn."""
        self._take_is_due = False
        for _ in range(_TAKEN_AT_ONCE):
            sock = self._outgoing.sock
            if sock is None:
                break
            try:
                if not self._take_packet(sock):
                    break
            except _UNPARSABLE as error:
                logger.error("%s: %s sent what is not MQTT: %s", self._name, self._address, error)
                self._broken()
                break
        else:
            self._take_is_due = True
        try:
            while self._notes:
                act, args = self._notes.popleft()
                act(*args)
        finally:
            if self._notes:  # a role failed: the loop reports it, and the rest is still delivered
                self._take_is_due = True
            if self._take_is_due:
                self._loop.call_soon(self.take)

    def note(self, act: Callable[..., None], *args: Any) -> None:
        """Call `act` once paho has returned."""
        self._notes.append((act, args))

    def acknowledge(self, receipt: Receipt) -> None:
        """Send the PUBACK of a message, unless another connection received it; to be called in the order of arrival."""
        serial, mid = receipt
        if serial == self._serial:
            self._outgoing.send(puback(mid))

    def _take_packet(self, sock: Buffered) -> bool:
        """Process the first received packet; returns False if none is complete."""
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
        elif end - start > _LONGEST_OTHER:
            raise ValueError(f"{end - start} bytes that are no PUBLISH; expected at most {_LONGEST_OTHER}")
        elif came[start] & KIND == PUBACK:
            self.was_served = True
            self._outgoing.owe_an_answer()  # the next waiting message
            self.note(self._outgoing.on_puback, *acknowledged(came, body, end))
        elif came[start] == PINGRESP:
            self.was_served = True
            self._keep_alive.answered(self._loop.time())
        else:
            self._outgoing.owe_an_answer()
            sock.for_paho = came[start:end]
            self._client.loop_read()
        return True

    def _take_message(self, came: bytes, start: int, body: int, end: int) -> None:
        name, payload, qos, mid = message_of(came, start, body, end, self._aliases)
        receipt = (self._serial, mid) if self._serial is not None and qos else None
        try:
            message = Inbound(name.decode(), payload, qos, came[start] & RETAIN != 0, receipt)
        except UnicodeDecodeError:
            receipt = None
            self.note(self._events.count, "topic", f"{self._name}: a topic that is not UTF-8")
        else:
            self.note(self._events.received, self._name, message)
        if qos:
            self._outgoing.owe_an_answer()
            if receipt is None:
                # The PUBACK follows once the role has handled the message, and forwarded a command.
                self.note(self._outgoing.send, puback(mid))
