"""A role's connection to an MQTT broker, which reconnects after a loss.

Each attempt is a new client, by default with a clean start and session expiry 0: nothing of an old connection is sent
on a new one. The role itself repeats messages that must not be lost, because it knows deadlines; a queue does not.
"""

from __future__ import annotations

import asyncio
import random
import secrets
import ssl
from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING

from ...errors import BrokerRefused, ConfigurationError
from ..address import BrokerAddress
from ..effects import Publish, Receipt, Subscribe, Unsubscribe, Will
from .connection import Connection
from .events import LinkEvents
from .outage import Outage
from .sn.connection import SnConnection
from .sn.topic_ids import TopicIds

if TYPE_CHECKING:
    from ...security.identity import Identity

FIRST_PAUSE_S = 0.2
LONGEST_PAUSE_S = 5.0
GOODBYE_S = 1.0
"""How long a broker that reads no bytes, or acknowledges no message, may delay the end."""
UNSERVED = "accepted, and ended before any message"
SESSION_TAKEN_OVER = 0x8E
SECRET_BYTES = 8
"""Random bytes after the client id of a node with an identity: no other member of the fleet can take it over."""
_PERMANENT = frozenset({0x84, 0x85, 0x86, 0x87, 0x8A, 0x8C, 0x90, 0x95, 0x99, 0x9A, 0x9B})
"""CONNACK reason codes for which a retry is pointless (MQTT 5.0, 3.2.2.2)."""


class MqttLink:
    """A named connection to a broker. `run` keeps it up until it is closed, cancelled or refused by the broker.

    `will` returns the will of each new connection. With `manual_ack` an inbound QoS 1 message counts as delivered only
    once the role has acknowledged its receipt, in the order of arrival (MQTT 5.0, 4.6). The broker sends the others
    again on the next connection, if that has the same client id and begins within `session_expiry_s`; this is for
    clients that only subscribe. `longest_pause_s` is the longest pause between two attempts to connect.

    `identity` is this node's, for `mqtts://` to a broker of its fleet; without it, `ssl_context` applies, or the
    system's certificate authorities. Raises ConfigurationError for either of these with `mqtt://`.

    A broker's final refusal, or its report that another client took over the id, ends a link that `may_be_ended`. Any
    other link tries again, and so does each with `mqtt-sn://`, where anyone may have sent the datagram.

    `aliases` is how many topics the broker may give aliases to. `root` is the root of the topics that an MQTT-SN
    gateway knows by number. `link` names the role's link if this is one of its several connections.
    """

    def __init__(
        self,
        name: str,
        address: BrokerAddress,
        client_id: str,
        will: Callable[[], Will] | None,
        events: LinkEvents,
        *,
        manual_ack: bool = False,
        session_expiry_s: int = 0,
        longest_pause_s: float = LONGEST_PAUSE_S,
        ssl_context: ssl.SSLContext | None = None,
        identity: Identity | None = None,
        may_be_ended: bool = True,
        aliases: int = 0,
        root: str = "",
        link: str | None = None,
    ) -> None:
        for given, what in ((ssl_context, "ssl_context"), (identity, "identity")):
            if given is not None and not (address.tls or (address.datagrams and what == "identity")):
                raise ConfigurationError(f"{what} for {address}: expected a broker at mqtts://")
        self.name = name
        self.address = address
        self.publish: Callable[[Publish], object]
        """Publishes on the connection. Without one the message is dropped; the role is notified of the reconnection."""
        self.subscribe: Callable[[Subscribe], None]
        self.unsubscribe: Callable[[Unsubscribe], None]
        self.failure: str | None = None
        """Why the last attempt to connect failed; None if it succeeded."""
        self._ssl_context = ssl_context
        self._identity = identity
        self._may_be_ended = may_be_ended and not address.datagrams
        self._aliases = aliases
        self._root = root
        is_secret = identity is not None and session_expiry_s == 0
        self._client_id = f"{client_id}-{secrets.token_hex(SECRET_BYTES)}" if is_secret else client_id
        self._will = will
        self._events = events
        self._manual_ack = manual_ack
        self._session_expiry_s = session_expiry_s
        self._longest_pause_s = longest_pause_s
        self._is_closed = False
        self._failures = 0
        self._unanswered = 0
        """Attempts without an answer: a CONNECT of theirs may come late, and take over a newer connection's id."""
        self._has_been_up = self._was_accepted = self._goes_on_at_once = False
        self._outage = Outage(link or name, address)
        self._use(None)

    async def run(self) -> None:
        """Connect, and reconnect after each loss; raises BrokerRefused when a retry is pointless.

        Raises ConfigurationError if the broker demands a certificate of a node without an identity that was never
        connected to it.
        """
        now_s, pause_s = asyncio.get_running_loop().time, FIRST_PAUSE_S
        while not self._is_closed:
            reason = self.failure = await self._one_connection()
            if self._is_closed:
                return
            if reason is None or self._goes_on_at_once:
                pause_s = FIRST_PAUSE_S
            if reason is None:
                self._outage.begin(now_s())
            else:
                self._failures += 1
                self._outage.fail(reason, now_s(), was_accepted=self._was_accepted)
            await asyncio.sleep(pause_s * random.uniform(0.5, 1.0))
            pause_s = min(2 * pause_s, self._longest_pause_s)

    def acknowledge(self, receipt: Receipt) -> None:
        """Acknowledge an inbound message on a link with `manual_ack`; does nothing if its connection has ended."""
        if self._connection is not None:
            self._connection.acknowledge(receipt)

    def ping(self) -> None:
        """Measure the connection, if there is one."""
        if self._connection is not None:
            self._connection.ping()

    def usual_s(self) -> float:
        """The usual upper bound of the broker's round trip, s; infinite if it does not answer."""
        return self._connection.usual_s() if self._connection is not None else inf

    def check_broker(self) -> None:
        """Give up a connection to a broker whose certificate is no longer good, after a revocation for example."""
        if self._identity is not None and self._connection is not None:
            wrong = self._connection.wrong_with_broker(self._identity)
            if wrong is not None:
                self._connection.give_up(wrong)

    def give_up(self, reason: str) -> None:
        """End the connection, if there is one, with its will; `run` then opens a new one."""
        if self._connection is not None:
            self._goes_on_at_once = self._connection.was_served
            self._connection.give_up(reason)

    async def close(self) -> None:
        """Write pending messages, disconnect cleanly and end `run`; takes at most twice `GOODBYE_S`."""
        self._is_closed = True
        connection = self._connection
        self._use(None)
        if connection is not None:
            await connection.settled(GOODBYE_S)
            await connection.leave(GOODBYE_S)

    def _made(self, ssl_context: ssl.SSLContext | None) -> Connection | SnConnection:
        will = self._will() if self._will is not None else None
        if self.address.datagrams:
            return SnConnection(
                self.name,
                self.address,
                self._client_id,
                will,
                self._events,
                ids=TopicIds(self._root),
                failures=self._failures,
            )
        return Connection(
            self.name,
            self.address,
            self._client_id,
            will,
            self._events,
            manual_ack=self._manual_ack,
            session_expiry_s=self._session_expiry_s,
            ssl_context=ssl_context,
            aliases=self._aliases,
        )

    def _use(self, connection: Connection | SnConnection | None) -> None:
        """Use this connection, or none, from now on for what is published, subscribed and unsubscribed."""
        self._connection = connection
        self.publish = connection.publish if connection is not None else _drop
        self.subscribe = connection.subscribe if connection is not None else _drop
        self.unsubscribe = connection.unsubscribe if connection is not None else _drop

    async def _one_connection(self) -> str | None:
        """Run one connection from CONNECT to its end; returns why it failed or was of no use, None if it was of use."""
        self._was_accepted = self._goes_on_at_once = False
        if self._identity is None or self.address.datagrams:
            return await self._one_connection_without_identity()
        from .tls import client_context

        try:
            # Read for each connection: an identity is renewed while its node runs.
            context = client_context(self._identity)
        except OSError as error:
            return f"the identity cannot be used: {error.strerror or error}"
        reason = await self._one_connection_by(context)
        return f"it refuses this node's certificate: {context.alert}" if context.alert is not None else reason

    async def _one_connection_without_identity(self) -> str | None:
        if self._ssl_context is not None or not self.address.tls:
            return await self._one_connection_by(self._ssl_context)
        from .alerts import CERTIFICATE_REQUIRED, system_context

        context, alerts = system_context()
        reason = await self._one_connection_by(context)
        if reason is not None and "CERTIFICATE_VERIFY_FAILED" in reason:
            return f"{reason}; a fleet's own broker is known by an identity (`identity`)"
        if CERTIFICATE_REQUIRED not in alerts:
            return reason
        reason = "the broker demands a certificate of this node; expected an identity (`identity`)"
        if self._may_be_ended and not self._has_been_up:
            raise ConfigurationError(f"{self.address}: {reason}")
        return reason

    async def _one_connection_by(self, ssl_context: ssl.SSLContext | None) -> str | None:
        connection = self._made(ssl_context)
        told: asyncio.TimerHandle | None = None
        try:
            try:
                code = await connection.open()
            except TimeoutError:
                self._unanswered += 1
                return "no answer in time"
            except OSError as error:
                return f"{error.strerror or error}"
            if code in _PERMANENT and self._may_be_ended:
                raise BrokerRefused(f"{self.name}: {self.address} refused the connection with reason code 0x{code:02x}")
            if code != 0:
                return f"refused with reason code 0x{code:02x}"
            if self._is_closed:
                return None
            self._use(connection)
            self._has_been_up = self._was_accepted = True
            loop = asyncio.get_running_loop()
            if self._outage.patience_s > 0:
                told = loop.call_later(self._outage.patience_s, lambda: self._outage.end(loop.time()))
            else:
                self._outage.end(loop.time())
            self._events.connected(self.name)
            try:
                code = await connection.ended
            except BrokerRefused:
                if self._may_be_ended:
                    raise
                return connection.refusal
            if code == SESSION_TAKEN_OVER:
                reason = f"another client took over the id {self._client_id}"
                if self._may_be_ended and self._unanswered == 0:
                    raise BrokerRefused(f"{self.name}: {self.address}: {reason}")
                self._unanswered = max(0, self._unanswered - 1)
                return reason
            return connection.refusal or (None if connection.was_served else UNSERVED)
        finally:
            if told is not None:
                told.cancel()
            was_up = self._connection is connection
            self._use(None)
            connection.close(with_will=not self._is_closed)
            if was_up:
                self._events.disconnected(self.name)


def _drop(_effect: object) -> None:
    """Ignore an effect, because there is no connection."""
