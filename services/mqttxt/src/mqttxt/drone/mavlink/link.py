"""The one module that talks MAVLink to an autopilot: over UDP, TCP or a serial line.

A write goes straight to the operating system or not at all: a queue of our own would be a place where a
command waits beyond its deadline unseen.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import serial
from pymavlink.dialects.v20 import common as mavlink

from ...core.address import is_host, whole_number
from ...errors import ConfigurationError
from .frame_parser import Malformed, StreamFrames, in_datagram
from .plans import AUTOPILOT_COMPONENT
from .repeated_acks import Repeats
from .sources import Source
from .vehicle import HEARTBEAT_LOST_MS

logger = logging.getLogger("mqttxt.mavlink")

REOPEN_S = 1.0
MAX_BAUD = 99_999_999
_READ_BYTES = 65_536
_READS_AT_ONCE = 1000


@dataclass(frozen=True)
class AutopilotAddress:
    """Where the autopilot is: `udp:HOST:PORT` (listen), `tcp:HOST:PORT` (connect), `serial:DEVICE:BAUD`."""

    kind: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> AutopilotAddress:
        """Raises ConfigurationError where `text` is none of the three."""
        kind, _, rest = text.partition(":")
        host, _, number = rest.rpartition(":")
        is_known = "\0" not in host and host != "" if kind == "serial" else is_host(host)
        if kind not in ("udp", "tcp", "serial") or not is_known:
            raise ConfigurationError(f"autopilot {text!r}: expected udp:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD")
        what, most = ("baud rate", MAX_BAUD) if kind == "serial" else ("port", 65_535)
        found = whole_number(number, most)
        if found is None:
            raise ConfigurationError(f"autopilot {text!r}: expected a {what} from 1 to {most}, got {number[:20]!r}")
        return cls(kind, host, found)

    def __str__(self) -> str:
        return f"{self.kind}:{self.host}:{self.port}"


class AutopilotLink:
    """A link to one autopilot; `on_message` gets each MAVLink message, `on_malformed` what was none."""

    def __init__(
        self,
        address: AutopilotAddress,
        system_id: int,
        on_message: Callable[[Any], None],
        on_malformed: Callable[[str], None],
    ) -> None:
        self.address = address
        self._system_id = system_id
        self._encoders = {
            source: mavlink.MAVLink(None, srcSystem=source.system(system_id), srcComponent=source.component)
            for source in Source
        }
        self._on_message = on_message
        self._on_malformed = on_malformed
        self._transport: _Transport | None = None

    async def run(self) -> None:
        """Keep the link open until cancelled; raises ConfigurationError when the address cannot be listened on."""
        while True:
            try:
                self._transport = await _open(self.address, self._system_id)
            except OSError as error:
                if self.address.kind == "udp":
                    raise ConfigurationError(
                        f"autopilot {self.address}: cannot listen: {error.strerror or error}"
                    ) from error
                logger.info("autopilot %s: %s; trying again", self.address, error.strerror or error)
                await asyncio.sleep(REOPEN_S)
                continue
            try:
                await self._read(self._transport)
            finally:
                self._transport.close()
                self._transport = None
            logger.info("autopilot %s: link closed; opening it again", self.address)
            await asyncio.sleep(REOPEN_S)

    def write(self, message: Any, source: Source = Source.COMPANION) -> bool:
        """Hand one message to the operating system, in the name of `source`; False when it did not take all of it."""
        if self._transport is None:
            return False
        encoder = self._encoders[source]
        packet = message.pack(encoder)
        encoder.seq = (encoder.seq + 1) % 256
        return self._transport.write(packet)

    async def _read(self, transport: _Transport) -> None:
        loop = asyncio.get_running_loop()
        ended: asyncio.Future[None] = loop.create_future()
        repeats = Repeats()

        def readable() -> None:
            """All that is there: an acknowledgement behind other messages is heard before a tick says it is missing."""
            for _ in range(_READS_AT_ONCE):
                found = transport.read(loop.time())
                if found is None and not ended.done():
                    ended.set_result(None)
                if found is None or not found.was_there:
                    return
                for message in found.messages:
                    if isinstance(message, Malformed):
                        self._on_malformed(message.reason)
                    elif not repeats.is_copy(message, loop.time()):
                        self._on_message(message)

        loop.add_reader(transport.fileno(), readable)
        try:
            await ended
        finally:
            loop.remove_reader(transport.fileno())


@dataclass(frozen=True)
class _Read:
    """What one reading brought; `was_there` false where nothing was there to read."""

    messages: Iterable[Any] = ()
    was_there: bool = True


_NOTHING = _Read(was_there=False)


class _Transport:
    """Non-blocking. `read` takes the time in seconds and returns None when the other side has closed."""

    def fileno(self) -> int:
        raise NotImplementedError

    def read(self, now_s: float) -> _Read | None:
        raise NotImplementedError

    def write(self, packet: bytes) -> bool:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError


class _Udp(_Transport):
    """Listens to one autopilot, and answers where its heartbeats come from.

    The peer is whoever sent a valid heartbeat of the drone's autopilot. While those keep coming nobody else is heard on
    this socket: what another one sends is neither parsed nor a reason to write there. Before there is a peer, everybody
    is heard, and nobody is written to.
    """

    def __init__(self, address: AutopilotAddress, system_id: int) -> None:
        self._system_id = system_id
        self._peer: Any = None
        self._peer_heard_s = 0.0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((address.host, address.port))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self, now_s: float) -> _Read | None:
        try:
            data, sender = self._socket.recvfrom(_READ_BYTES)
        except OSError:  # nothing there, or an ICMP error for an earlier datagram
            return _NOTHING
        if sender != self._peer and self._peer is not None and now_s - self._peer_heard_s <= HEARTBEAT_LOST_MS / 1000:
            return _Read([Malformed(f"a datagram of {sender[0]}:{sender[1]}, which is not the autopilot's")])
        messages = list(in_datagram(data))
        if any(self._is_heartbeat(message) for message in messages):
            if sender != self._peer:
                logger.info("the autopilot is at %s:%d", *sender)
            self._peer, self._peer_heard_s = sender, now_s
        return _Read(messages)

    def _is_heartbeat(self, message: Any) -> bool:
        if isinstance(message, Malformed) or message.get_type() != "HEARTBEAT":
            return False
        return bool((message.get_srcSystem(), message.get_srcComponent()) == (self._system_id, AUTOPILOT_COMPONENT))

    def write(self, packet: bytes) -> bool:
        if self._peer is None:
            return False
        try:
            return self._socket.sendto(packet, self._peer) == len(packet)
        except OSError:
            return False

    def close(self) -> None:
        self._socket.close()


class _Tcp(_Transport):
    """A TCP connection to the autopilot or its simulator."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._frames = StreamFrames()

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self, now_s: float) -> _Read | None:
        try:
            data = self._socket.recv(_READ_BYTES)
        except BlockingIOError:
            return _NOTHING
        except OSError:
            return None
        return _Read(self._frames.feed(data, now_s)) if data else None

    def write(self, packet: bytes) -> bool:
        try:
            return self._socket.send(packet) == len(packet)
        except OSError:
            return False

    def close(self) -> None:
        self._socket.close()


class _Serial(_Transport):
    """A serial line."""

    def __init__(self, address: AutopilotAddress) -> None:
        try:
            self._port = serial.Serial(address.host, address.port, timeout=0, write_timeout=0)
            self._frames = StreamFrames()
        except ValueError as error:
            raise ConfigurationError(f"autopilot {address}: {error}; expected a rate that the device has") from error

    def fileno(self) -> int:
        return int(self._port.fileno())

    def read(self, now_s: float) -> _Read | None:
        try:
            data = bytes(self._port.read(_READ_BYTES))
        except serial.SerialException:
            return None
        return _Read(self._frames.feed(data, now_s)) if data else _NOTHING

    def write(self, packet: bytes) -> bool:
        try:  # pyserial's own would try again without end where the device takes nothing
            return os.write(self._port.fileno(), packet) == len(packet)
        except OSError:
            return False

    def close(self) -> None:
        self._port.close()


async def _open(address: AutopilotAddress, system_id: int) -> _Transport:
    if address.kind == "udp":
        return _Udp(address, system_id)
    if address.kind == "serial":
        return _Serial(address)
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.setblocking(False)
    try:
        await asyncio.get_running_loop().sock_connect(sock, (address.host, address.port))
    except OSError:
        sock.close()
        raise
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return _Tcp(sock)
