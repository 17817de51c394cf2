"""The link to an autopilot: writes in the name of a component, and reads.

A write is passed straight to the operating system or fails: in a queue of the client's own a command could wait
unnoticed beyond its deadline.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
from collections.abc import Callable, Iterator
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ...errors import ConfigurationError
from .frame_parser import Malformed
from .repeated_acks import Repeats
from .signing import Signing, is_signed
from .sources import Source
from .transports import AutopilotAddress, Transport, open_transport

logger = logging.getLogger("mqttxt.mavlink")

REOPEN_S = 1.0
_NOT_YET = frozenset({errno.EADDRNOTAVAIL, socket.EAI_AGAIN})
"""The errors of a UDP address that this machine may get later, as after its start."""
_DISCARDED_AT_ONCE = 10_000
"""More datagrams than a socket's buffer holds; who floods it does not hold the loop for ever."""
_READS_AT_ONCE = 1000
_TURN_S = 0.5
"""How long one turn of reading may last. It takes a flood; what a socket's buffer holds is read in a part of this."""
_HAS_KEY = Malformed("mavlink_signed", "the autopilot signs its messages; expected --mavlink-key with its key")
_NO_STAMPS = Malformed("mavlink_no_stamps", "no time stamp of this key is left; expected another key at both ends")


class AutopilotLink:
    """A link to one autopilot; `on_readable` is called when there are `messages`, `on_malformed` for dropped input.

    With a `signing` both directions are signed, and other messages are dropped.
    """

    def __init__(
        self,
        address: AutopilotAddress,
        system_id: int,
        on_readable: Callable[[], None],
        on_malformed: Callable[[Malformed], None],
        signing: Signing | None = None,
    ) -> None:
        self.address = address
        self._system_id = system_id
        self._signing = signing
        self._encoders = {
            source: mavlink.MAVLink(None, srcSystem=source.system(system_id), srcComponent=source.component)
            for source in Source
        }
        if signing is not None:
            for encoder in self._encoders.values():
                signing.equip(encoder)
        self._on_readable = on_readable
        self._on_malformed = on_malformed
        self._judge = signing.judge if signing is not None else None
        self._transport: Transport | None = None
        self._closed: asyncio.Event = asyncio.Event()
        self._repeats = Repeats()

    async def run(self) -> None:
        """Keep the link open until cancelled. Raises ConfigurationError for a UDP address that cannot be."""
        told = ""
        while True:
            try:
                self._transport = await open_transport(self.address, self._system_id, self._judge)
            except OSError as error:
                if self.address.kind == "udp" and error.errno not in _NOT_YET:
                    raise ConfigurationError(
                        f"autopilot {self.address}: cannot listen: {error.strerror or error}"
                    ) from error
                why = error.strerror or str(error)
                if why != told:
                    logger.info("autopilot %s: %s; trying until it opens", self.address, why)
                told = why
                await asyncio.sleep(REOPEN_S)
                continue
            if told:
                logger.info("autopilot %s: the link is open", self.address)
            told = ""
            try:
                await self._read(self._transport)
            finally:
                self._transport.close()
                self._transport = None
            logger.info("autopilot %s: link closed; opening it again", self.address)
            await asyncio.sleep(REOPEN_S)

    def write(self, message: Any, source: Source = Source.COMPANION) -> bool:
        """Pass one message to the operating system, in the name of `source`; False unless it took all of it."""
        if self._transport is None:
            return False
        encoder = self._encoders[source]
        if self._signing is not None and not self._signing.stamp(encoder):
            self._on_malformed(_NO_STAMPS)
            return False
        packet = message.pack(encoder)
        encoder.seq = (encoder.seq + 1) % 256
        return self._transport.write(packet, is_heartbeat=message.get_type() == "HEARTBEAT")

    def messages(self) -> Iterator[Any]:
        """All received messages: so an acknowledgement among them is read before a tick takes it for missing.

        A flood is read in several turns, between which ticks and brokers have theirs.
        """
        now_s = asyncio.get_running_loop().time
        until_s = now_s() + _TURN_S
        for _ in range(_READS_AT_ONCE):
            at_s = now_s()
            if at_s > until_s:
                return
            found = self._transport.read(at_s) if self._transport is not None else None
            if found is None:
                self._closed.set()
            if found is None or not found.was_there:
                return
            for message in found.messages:
                if isinstance(message, Malformed):
                    self._on_malformed(message)
                    continue
                if self._signing is None and is_signed(message):
                    self._on_malformed(_HAS_KEY)
                if not self._repeats.is_copy(message, now_s()):
                    yield message

    def discard(self) -> None:
        """Read everything that has arrived, and drop it."""
        now_s = asyncio.get_running_loop().time()
        for _ in range(_DISCARDED_AT_ONCE):
            found = self._transport.skip(now_s) if self._transport is not None else None
            if found is None:
                self._closed.set()
            if found is None or not found.was_there:
                return

    async def _read(self, transport: Transport) -> None:
        """Read until the other side has closed the link."""
        loop = asyncio.get_running_loop()
        self._closed.clear()
        self._repeats = Repeats()
        loop.add_reader(transport.fileno(), self._on_readable)
        try:
            await self._closed.wait()
        finally:
            loop.remove_reader(transport.fileno())
