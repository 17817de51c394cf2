"""A witness as a process: its socket, and the files that the stand-in would have written."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from pathlib import Path

from ..datagrams import ANCILLARY_BYTES, LARGEST_DATAGRAM, arrival_ns, bind
from ..files import open_events, touch, write_event
from ..position_file import EVERY_S, PositionFile
from .witness import Witness

ALIVE_NS = 5_000_000_000
"""An autopilot whose last heartbeat is older is no longer ready."""


class Watching:
    """Watches one autopilot until cancelled. Raises SitlError for an address or a file that cannot be used."""

    def __init__(
        self,
        system: int,
        listen: tuple[str, int],
        *,
        events: Path | None = None,
        ready_file: Path | None = None,
        position_file: Path | None = None,
    ) -> None:
        self.witness = Witness(system)
        self._socket = bind(listen)
        self._events = open_events(events) if events is not None else None
        self._ready_file = ready_file
        self._position_file = PositionFile(position_file) if position_file is not None else None
        self._peer: tuple[str, int] | None = None
        self.taps: list[Callable[[bytes], object]] = []
        """Functions that also receive each datagram of the autopilot."""

    async def run(self, may_be_ready: Callable[[], bool] = lambda: True) -> None:
        """Watch until cancelled. Ready: the autopilot reports its place and that it would arm, and `may_be_ready`."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._socket, self._readable)
        try:
            while True:
                now_ns = time.time_ns()
                self._ask(now_ns)
                witness = self.witness
                if self._position_file is not None and witness.place is not None:
                    self._position_file.write(witness.place)
                alive = witness.heard_ns is not None and now_ns - witness.heard_ns < ALIVE_NS
                ready = alive and witness.place is not None and witness.is_armable and may_be_ready()
                if ready and self._ready_file is not None:
                    touch(self._ready_file)
                await asyncio.sleep(EVERY_S)
        finally:
            loop.remove_reader(self._socket)
            self._socket.close()
            if self._events is not None:
                self._events.close()

    def send(self, datagram: bytes) -> None:
        """Send to the autopilot, once its address is known."""
        if self._peer is not None:
            with contextlib.suppress(OSError):  # it no longer listens: its heartbeats stop, too
                self._socket.sendto(datagram, self._peer)

    def _ask(self, now_ns: int) -> None:
        if self._peer is not None:
            for request in self.witness.requests(now_ns):
                self.send(request)

    def _readable(self) -> None:
        try:
            data, ancillary, _, peer = self._socket.recvmsg(LARGEST_DATAGRAM, ANCILLARY_BYTES)
        except OSError:  # an ICMP error for an earlier request: nobody listens there
            return
        t_ns = arrival_ns(ancillary)
        events = self.witness.take(data, t_ns)
        if self.witness.told_ns == t_ns:  # it has a frame of the autopilot: anybody may send here
            self._peer = peer
            for tap in self.taps:
                tap(data)
        for event in events:
            if self._events is not None:
                write_event(self._events, t_ns, **event)
