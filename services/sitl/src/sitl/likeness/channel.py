"""Ways to an autopilot: UDP in real time, or the stand-in's vehicle in simulated time."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from pymavlink.dialects.v20 import development as mavlink

from ..errors import SitlError
from ..outputs import Reply
from ..unnamed import NAMES
from ..vehicle import Vehicle

GCS_SYSTEM, GCS_COMPONENT = 245, 190
TICK_S = 0.01
TELLING = frozenset(
    {
        *("HEARTBEAT", "EXTENDED_SYS_STATE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "SYS_STATUS"),
        *("HOME_POSITION", "MISSION_CURRENT"),
    }
)
"""The messages by which a flight is followed; all others would take most of the time of a simulated flight."""


@dataclass(frozen=True)
class Heard:
    """A received message: its arrival in seconds, size on the wire in bytes, kind, and the system that sent it."""

    at_s: float
    message: Any
    size_bytes: int
    kind: str
    system: int


class Channel(Protocol):
    """A link to one autopilot, with the clock that times its messages."""

    @property
    def now_s(self) -> float: ...

    def close(self) -> None:
        """Close the link: nothing is sent or received any more."""
        ...

    def attend(self, everything: bool) -> None:
        """Receive every message from now on, or only those in TELLING."""

    def send(self, message: Any) -> None: ...

    def listen(self, seconds: float) -> Iterator[Heard]:
        """Yield the messages of the next `seconds`, as they arrive."""
        ...


class UdpChannel:
    """A link over UDP on loopback, in real time; without the autopilot's port, to the last sender to the own one."""

    def __init__(self, port: int | None, own_port: int = 0) -> None:
        self._learns = port is None
        self._to = None if port is None else ("127.0.0.1", port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(("127.0.0.1", own_port))
        except OSError as error:
            self._socket.close()
            raise SitlError(f"cannot receive on 127.0.0.1:{own_port}: {error.strerror}") from error
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._codec = mavlink.MAVLink(None, GCS_SYSTEM, GCS_COMPONENT)

    @property
    def now_s(self) -> float:
        return time.monotonic()

    def close(self) -> None:
        self._socket.close()

    def attend(self, everything: bool) -> None:
        """Ignored: every message is received."""

    def send(self, message: Any) -> None:
        if self._to is None:
            return
        self._socket.sendto(message.pack(self._codec), self._to)
        self._codec.seq = (self._codec.seq + 1) % 256

    def listen(self, seconds: float) -> Iterator[Heard]:
        end_s = self.now_s + seconds
        while (left_s := end_s - self.now_s) > 0:
            self._socket.settimeout(left_s)
            try:
                datagram, sender = self._socket.recvfrom(65_536)
            except (TimeoutError, ConnectionError):
                continue
            at_s = self.now_s
            if self._learns:
                self._to = sender
            yield from heard_in(at_s, datagram)


def heard_in(at_s: float, datagram: bytes) -> Iterator[Heard]:
    """The messages of a datagram that arrived at `at_s`."""
    parser = mavlink.MAVLink(None)  # a new one each time: no frame spans two datagrams
    parser.robust_parsing = True
    for message in parser.parse_buffer(datagram) or ():
        if message.get_type() != "BAD_DATA":
            yield _heard(at_s, message)


def _heard(at_s: float, message: Any) -> Heard:
    """A parsed message as received; one that pymavlink does not know is named by its frame."""
    frame = message.get_msgbuf()
    if frame[0] != mavlink.PROTOCOL_MARKER_V2:
        return Heard(at_s, message, len(frame), message.get_type(), frame[3])
    kind = NAMES.get(int.from_bytes(frame[7:10], "little"), message.get_type())
    return Heard(at_s, message, len(frame), kind, frame[5])


@dataclass
class Clock:
    """Simulated time, which all links of a vehicle have in common."""

    now_s: float = 0.0


class SimulatedChannel:
    """The stand-in's vehicle without a process; time goes on as fast as it can be computed."""

    def __init__(self, vehicle: Vehicle, link: int, clock: Clock) -> None:
        self._vehicle = vehicle
        self._clock = clock
        self._link = link
        self._codec = mavlink.MAVLink(None, GCS_SYSTEM, GCS_COMPONENT)
        self._sizes = mavlink.MAVLink(None, vehicle.config.system_id, 1)
        self._answers: list[Any] = []

    def close(self) -> None:
        """There is nothing to close."""

    def attend(self, everything: bool) -> None:
        self._vehicle.muted = set() if everything else set(self._vehicle.telemetry.makers) - TELLING

    @property
    def now_s(self) -> float:
        return self._clock.now_s

    def send(self, message: Any) -> None:
        for parsed in mavlink.MAVLink(None).parse_buffer(message.pack(self._codec)) or ():
            self._answers += [o.message for o in self._vehicle.handle(self._link, parsed) if isinstance(o, Reply)]

    def listen(self, seconds: float) -> Iterator[Heard]:
        end_s = self.now_s + seconds
        while self._answers or self.now_s < end_s:
            answers, self._answers = self._answers, []
            yield from self._heard(answers)
            if self.now_s >= end_s:
                continue
            self._clock.now_s += TICK_S
            told = [o.message for o in self._vehicle.advance(self.now_s) if isinstance(o, Reply)]
            yield from self._heard([*told, *self._vehicle.streamed(self._link, self.now_s)])

    def _heard(self, messages: list[Any]) -> Iterator[Heard]:
        for message in messages:
            size = len(message.pack(self._sizes))
            yield Heard(self.now_s, message, size, message.get_type(), self._sizes.srcSystem)
