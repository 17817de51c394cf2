"""The stand-in as a process: UDP links, the side channel, the events file, and the clock."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from pymavlink.dialects.v20 import development as mavlink

from .control_socket import served
from .datagrams import ANCILLARY_BYTES, LARGEST_DATAGRAM, arrival_ns, bind
from .files import open_events, touch, write_event
from .outputs import Happened, Output
from .position_file import EVERY_S, PositionFile
from .signing import Signing
from .vehicle import Vehicle

logger = logging.getLogger("sitl")

TICK_S = 0.01
_READ_AT_ONCE = 64
POSITION_S = 1.0


@dataclass(frozen=True)
class LinkConfig:
    """A UDP link: bound to `listen`, sending to `send` until a message arrives from another address."""

    listen: tuple[str, int]
    send: tuple[str, int]
    streams: str


class _Link:
    """One UDP link of the vehicle."""

    def __init__(self, process: Process, number: int, config: LinkConfig) -> None:
        self._process = process
        self._number = number
        self._peer: tuple[str, int] = config.send
        self._codec = process.signing.codec()
        self._socket = bind(config.listen)

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        loop.add_reader(self._socket, self._readable)

    def close(self, loop: asyncio.AbstractEventLoop) -> None:
        loop.remove_reader(self._socket)
        self._socket.close()

    def _readable(self) -> None:
        """Read the datagrams that have arrived, at most _READ_AT_ONCE."""
        for _ in range(_READ_AT_ONCE):
            try:
                data, ancillary, _, addr = self._socket.recvmsg(LARGEST_DATAGRAM, ANCILLARY_BYTES)
            except BlockingIOError:
                return
            except OSError:  # an ICMP error for an earlier datagram: nobody listens there yet
                continue
            self._take(data, addr, arrival_ns(ancillary))

    def _take(self, data: bytes, addr: Any, arrived_ns: int) -> None:
        codec = self._codec
        for message in codec.parse_buffer(data) or ():
            kind = message.get_type()
            if kind == "BAD_DATA":
                self._process.count(" ".join(message.reason.split()[:2]), message.reason)
            elif kind.startswith("UNKNOWN"):
                self._process.count("unknown message", kind)
            elif kind == "SETUP_SIGNING":
                self._process.set_up_signing(message)
            else:
                self._peer = addr
                self._process.on_message(self._number, message, arrived_ns)
        if codec.buf_len():
            # A frame never spans datagrams: the rest of a cut one must not swallow the next.
            self._process.count("cut short", f"{codec.buf_len()} bytes left over")
            codec.buf, codec.buf_index = bytearray(), 0

    def send(self, message: Any) -> None:
        with contextlib.suppress(OSError):  # nobody listens there yet: as a real autopilot, it keeps sending
            self._socket.sendto(message.pack(self._codec), self._peer)
        self._codec.seq = (self._codec.seq + 1) % 256


class Process:
    """Runs a vehicle in real time until cancelled."""

    def __init__(
        self,
        vehicle: Vehicle,
        links: list[LinkConfig],
        *,
        events: Path | None = None,
        control: Path | None = None,
        ready_file: Path | None = None,
        position_file: Path | None = None,
        key: bytes | None = None,
    ) -> None:
        self.vehicle = vehicle
        self.signing = Signing(vehicle.config.system_id, vehicle.like.unsigned, key)
        self._configs = links
        self._links: list[_Link] = []
        self._events_path = events
        self._events: TextIO | None = None
        self._control = control
        self._ready_file = ready_file
        self._position_file = PositionFile(position_file) if position_file is not None else None
        self._counts: Counter[str] = Counter()
        self._started = time.monotonic()

    async def run(self) -> None:
        """Run until cancelled. Raises SitlError if an address or a file cannot be used."""
        loop = asyncio.get_running_loop()
        async with contextlib.AsyncExitStack() as stack:
            if self._events_path is not None:
                self._events = stack.enter_context(open_events(self._events_path))
            for number, config in enumerate(self._configs):
                link = _Link(self, number, config)
                link.open(loop)
                stack.callback(link.close, loop)
                self._links.append(link)
            if self._control is not None:
                await stack.enter_async_context(served(self._control, self._on_control))
            await self._fly()

    def on_message(self, link: int, message: Any, arrived_ns: int) -> None:
        self._carry_out(link, self.vehicle.handle(link, message), arrived_ns)

    def set_up_signing(self, message: Any) -> None:
        """Take the key of a SETUP_SIGNING, only while disarmed."""
        if not self.vehicle.is_for_us(message):
            return
        if self.vehicle.autopilot.armed:
            self.vehicle.autopilot.say("Signing is not set up while armed", mavlink.MAV_SEVERITY_ERROR)
        else:
            self.signing.set_up(message)

    def count(self, kind: str, detail: str) -> None:
        self._counts[kind] += 1
        if self._counts[kind] == 1:
            logger.warning("%s: %s (further ones are counted, not logged)", kind, detail)

    async def _fly(self) -> None:
        next_tick_s = next_mark_s = next_position_s = 0.0
        while True:
            now_s = time.monotonic() - self._started
            self._carry_out(None, self.vehicle.advance(now_s))
            for number, link in enumerate(self._links):
                for message in self.vehicle.streamed(number, now_s):
                    link.send(message)
            if now_s >= next_mark_s:
                next_mark_s = now_s + POSITION_S
                self._write(self.vehicle.position())
                if self._ready_file is not None:
                    touch(self._ready_file)
            if self._position_file is not None and now_s >= next_position_s:
                next_position_s = now_s + EVERY_S
                self._position_file.write(self.vehicle.position().detail)
            # Ticks keep to a grid: else each would be late by its own work, and a stream of 100 Hz slower than that.
            next_tick_s = max(next_tick_s + TICK_S, now_s)
            await asyncio.sleep(next_tick_s - (time.monotonic() - self._started))

    def _carry_out(self, link: int | None, outputs: list[Output], arrived_ns: int | None = None) -> None:
        """Write events down; send replies to the link that asked, and unasked messages to all links."""
        for output in outputs:
            if isinstance(output, Happened):
                self._write(output, arrived_ns)
                continue
            to_all = link is None or output.message.get_type() in ("HEARTBEAT", "STATUSTEXT")
            for number, one in enumerate(self._links):
                if to_all or number == link:
                    one.send(output.message)

    def _write(self, happened: Happened, arrived_ns: int | None = None) -> None:
        """Write a line of the events file; after a message, with the time at which the kernel received it."""
        if self._events is not None:
            arrived = {} if arrived_ns is None else {"arrived_ns": arrived_ns}
            write_event(self._events, time.time_ns(), happened.event, **happened.detail, **arrived)

    async def _on_control(self, request: Any) -> dict[str, Any]:
        answer, outputs = self.vehicle.control(request)
        self._carry_out(None, outputs)
        return answer
