"""The transports of an autopilot's link: UDP, TCP or a serial line, never blocking."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import serial

from ...core.address import is_host, whole_number
from ...errors import ConfigurationError
from .autopilots import is_autopilots, kind_of
from .frame_parser import NO_FRAME, Malformed, StreamFrames, in_datagram
from .signing import NotTrusted
from .vehicle import HEARTBEAT_LOST_MS

logger = logging.getLogger("mqttxt.mavlink")

MAX_BAUD = 99_999_999
_READ_BYTES = 65_536
_DATAGRAM_BYTES = 8192
"""What is read of one datagram; senders put one frame into it, or as many as a network's packet holds."""

Judge = Callable[[Any, float], Any]
"""Takes a received message and the time in seconds; returns the message, or Malformed."""


@dataclass(frozen=True)
class AutopilotAddress:
    """The address of an autopilot: `udp:HOST:PORT` (listen), `tcp:HOST:PORT` (connect), `serial:DEVICE:BAUD`."""

    kind: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> AutopilotAddress:
        """Parse one of the three forms. Raises ConfigurationError."""
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


def _judged(found: Iterable[Any], judge: Judge | None, now_s: float) -> Iterable[Any]:
    """The received messages, with Malformed in place of those that are not trusted; without a judge all are."""
    return found if judge is None else (each if isinstance(each, Malformed) else judge(each, now_s) for each in found)


@dataclass(frozen=True)
class Read:
    """The result of one read; `was_there` is false if nothing had arrived."""

    messages: Iterable[Any] = ()
    was_there: bool = True


_NOTHING = Read(was_there=False)
_SKIPPED = Read()


class Transport:
    """Non-blocking. `read` takes the time in seconds, and returns None once the other side has closed."""

    def __init__(self, judge: Judge | None) -> None:
        self._judge = judge

    def fileno(self) -> int:
        raise NotImplementedError

    def read(self, now_s: float) -> Read | None:
        raise NotImplementedError

    def skip(self, now_s: float) -> Read | None:
        """Read, and drop what has arrived. A stream is parsed only where its messages are taken."""
        return self.read(now_s)

    def write(self, packet: bytes, *, is_heartbeat: bool = False) -> bool:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError


class Udp(Transport):
    """Listens to one autopilot, and writes to the address from which its heartbeats arrive.

    The peer is the sender of a valid heartbeat of the drone's autopilot, of a known kind. While such heartbeats
    continue, datagrams of other senders are neither parsed nor answered. Before there is a peer, datagrams of all
    senders are read, and nothing is written, except heartbeats to the sender of one with a correct signature and an
    old time stamp. From them an autopilot that started without a clock learns the time (R13.6).
    """

    def __init__(self, address: AutopilotAddress, system_id: int, judge: Judge | None) -> None:
        super().__init__(judge)
        self._system_id = system_id
        self._peer: Any = None
        self._peer_heard_s = 0.0
        self._behind: Any = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((address.host, address.port))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self, now_s: float) -> Read | None:
        try:
            data, sender = self._socket.recvfrom(_DATAGRAM_BYTES)
        except OSError:  # nothing to read, or an ICMP error for an earlier datagram
            return _NOTHING
        if sender != self._peer and self._peer is not None and now_s - self._peer_heard_s <= HEARTBEAT_LOST_MS / 1000:
            reason = f"a datagram of {sender[0]}:{sender[1]}, which is not the autopilot's"
            return Read([Malformed(NO_FRAME, reason)])
        messages = list(_judged(in_datagram(data), self._judge, now_s))
        if any(self._is_heartbeat(message) for message in messages):
            if sender != self._peer:
                logger.info("the autopilot is at %s:%d", *sender)
            self._peer, self._peer_heard_s, self._behind = sender, now_s, None
        elif any(
            isinstance(each, NotTrusted) and each.is_stale and self._is_heartbeat(each.message) for each in messages
        ):
            self._behind = sender
        return Read(messages)

    def skip(self, now_s: float) -> Read | None:
        """Drop a datagram unparsed. It shows that the peer was there while nothing was read."""
        try:
            _, sender = self._socket.recvfrom(_DATAGRAM_BYTES)
        except OSError:
            return _NOTHING
        if sender == self._peer:
            self._peer_heard_s = now_s
        return _SKIPPED

    def _is_heartbeat(self, message: Any) -> bool:
        """Whether a message is a heartbeat of the drone's autopilot; other programs may use its system id."""
        if isinstance(message, Malformed) or message.get_srcSystem() != self._system_id:
            return False
        return is_autopilots(message) and kind_of(message) is not None

    def write(self, packet: bytes, *, is_heartbeat: bool = False) -> bool:
        if is_heartbeat and self._behind not in (None, self._peer):
            with contextlib.suppress(OSError):
                self._socket.sendto(packet, self._behind)
        if self._peer is None:
            return False
        try:
            return self._socket.sendto(packet, self._peer) == len(packet)
        except OSError:
            return False

    def close(self) -> None:
        self._socket.close()


class Tcp(Transport):
    """A TCP connection to the autopilot or its simulator."""

    def __init__(self, sock: socket.socket, judge: Judge | None) -> None:
        super().__init__(judge)
        self._socket = sock
        self._frames = StreamFrames()

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self, now_s: float) -> Read | None:
        try:
            data = self._socket.recv(_READ_BYTES)
        except BlockingIOError:
            return _NOTHING
        except OSError:
            return None
        return Read(_judged(self._frames.feed(data, now_s), self._judge, now_s)) if data else None

    def write(self, packet: bytes, *, is_heartbeat: bool = False) -> bool:
        try:
            return self._socket.send(packet) == len(packet)
        except OSError:
            return False

    def close(self) -> None:
        self._socket.close()


class Serial(Transport):
    """A serial line."""

    def __init__(self, address: AutopilotAddress, judge: Judge | None) -> None:
        import termios  # not on Windows, where addresses are parsed too

        super().__init__(judge)
        try:
            self._port = serial.Serial(address.host, address.port, timeout=0, write_timeout=0)
            self._frames = StreamFrames()
        except termios.error as error:  # no OSError: the device vanished while it was opened
            raise OSError(*error.args) from error
        except ValueError as error:
            fault = error.__context__  # that of setting an uncommon rate
            if isinstance(fault, OSError) and fault.errno == errno.EIO:
                raise fault from None
            raise ConfigurationError(f"autopilot {address}: {error}; expected a rate that the device has") from error

    def fileno(self) -> int:
        return int(self._port.fileno())

    def read(self, now_s: float) -> Read | None:
        try:
            data = bytes(self._port.read(_READ_BYTES))
        except serial.SerialException:
            return None
        return Read(_judged(self._frames.feed(data, now_s), self._judge, now_s)) if data else _NOTHING

    def write(self, packet: bytes, *, is_heartbeat: bool = False) -> bool:
        try:  # pyserial's own `write` retries without end while the device takes nothing
            return os.write(self._port.fileno(), packet) == len(packet)
        except OSError:
            return False

    def close(self) -> None:
        self._port.close()


async def open_transport(address: AutopilotAddress, system_id: int, judge: Judge | None) -> Transport:
    if address.kind == "udp":
        return Udp(address, system_id, judge)
    if address.kind == "serial":
        return Serial(address, judge)
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.setblocking(False)
    try:
        await asyncio.get_running_loop().sock_connect(sock, (address.host, address.port))
    except OSError:
        sock.close()
        raise
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return Tcp(sock, judge)
