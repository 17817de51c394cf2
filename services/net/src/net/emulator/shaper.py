"""The emulator's main loop: takes packets from their links' queues, holds each until it is due, and releases it.

One thread, one socket, one heap. A packet's time begins when the kernel received it, not when this process reads it: a
busy machine does not lengthen a delay that is not over yet. The work per packet is inlined in two loops, since this is
the hot path of all measurements: a call costs as much here as a decision.
"""

from __future__ import annotations

import errno
import gc
import heapq
import itertools
import select
import socket
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence

from . import nfqueue
from .injector import Injector
from .jitter import generator
from .link import CORRUPT, DROP, DUPLICATE, PASS, WAIT, Counters
from .network import Network, SettingsStep
from .nfqueue import Queues
from .rules import Way
from .timing import Lateness
from .turns import Sender

BATCH = 64
"""Packets taken before those that are due are released."""
ETHERNET_BYTES = 14
TICK_NS = 1_000_000_000
LOOK_NS = 10_000_000
"""How often other sockets are checked while packets leave no time to wait."""
STAMP_LIMIT_NS = 1_000_000_000
"""A time stamp that is further from now is not used."""
BUFFER_BYTES = 1 << 17
_NS = 1e-9
Tick = Callable[[], None]
_Held = tuple[int, int, Counters | None, bytes, tuple[Injector, bytes] | None]
"""Due time, number, the link's counters (None: dropped), the verdict, and a copy with its injector (None: no copy)."""


class Shaper:
    """The loop in `run`; between packets `tick` is called about once per second, and `said` with each event."""

    def __init__(
        self,
        network: Network,
        ways: Sequence[Way],
        queues: Queues,
        whole: frozenset[int],
        said: Callable[[Sequence[SettingsStep]], None],
    ) -> None:
        self.late = Lateness()
        self.overruns = 0
        """How often the socket reported a full buffer; the kernel counts the packets lost by it."""
        self._network = network
        self._links = [network.links[way.link] for way in ways]
        self._socket = queues.socket
        self._whole = whole
        self._said = said
        self._injectors = {
            queue: Injector(way.destination.interface, way.destination.cable.node)
            for queue, way in enumerate(ways)
            if queue in whole
        }
        self._accept = [nfqueue.verdict_prefix(queue, True) for queue in range(len(ways))]
        self._drop = [nfqueue.verdict_prefix(queue, False) for queue in range(len(ways))]
        self._held: list[_Held] = []
        self._waiting: dict[Sender, deque[tuple[int, bytes, bytes]]] = {link: deque() for link in self._links}
        """By link queue, id and payload of the packets that wait for their turn."""
        self._numbers = itertools.count()
        self._buffer = bytearray(BUFFER_BYTES)
        self._flips = generator(network.seed, "all", "bits")
        self._zero_ns = self._clock_zero_ns = 0

    @property
    def held(self) -> int:
        """The number of packets that wait for their turn or their time."""
        return len(self._held) + sum(map(len, self._waiting.values()))

    def run(self, heard: Mapping[socket.socket, Callable[[], None]], ended: Callable[[], bool], tick: Tick) -> None:
        """Shape packets until `ended`; time zero is now. `heard` has sockets with functions to call if readable."""
        gc.collect()
        gc.freeze()
        gc.disable()  # nothing here makes cycles, and a collection would stop all links for milliseconds
        self._zero_ns = zero_ns = time.monotonic_ns()
        tick_ns, look_ns = TICK_NS, 0
        self._read_clocks(zero_ns)
        sources = [self._socket, *heard]
        while not ended():
            now_ns = time.monotonic_ns() - zero_ns
            change_ns = self._network.next_change_ns
            if change_ns is not None and change_ns <= now_ns:
                self._said(self._network.change_until(now_ns))
                continue
            if now_ns >= tick_ns:
                tick()
                tick_ns = now_ns + TICK_NS
                self._read_clocks(zero_ns)
            more = self._take(zero_ns)
            if self._network.turns:
                self._take_turns(time.monotonic_ns() - zero_ns)
            self._let_go(zero_ns)
            left_ns = 0
            if not more:
                next_ns = min(tick_ns, change_ns or tick_ns, self._held[0][0] if self._held else tick_ns)
                for turns in self._network.turns:
                    next_ns = min(next_ns, turns.next_ns or tick_ns)
                left_ns = next_ns + zero_ns - time.monotonic_ns()
            if left_ns > 0 or now_ns >= look_ns:
                look_ns = now_ns + LOOK_NS
                ready, _, _ = select.select(sources, (), (), max(0, left_ns) * _NS)
                for source in ready:
                    if source is not self._socket:
                        heard[source]()

    def since_zero_ns(self, unix_ns: int) -> int:
        """Convert a time of the system's clock (unix time) to the links' time."""
        return unix_ns - self._clock_zero_ns

    def copy_whole(self, queues: Queues, queue: int, way: Way) -> None:
        """Copy a link's packets completely from now on, because it will corrupt or duplicate them."""
        if queue in self._whole:
            return
        self._injectors[queue] = Injector(way.destination.interface, way.destination.cable.node)
        queues.copy_whole(queue)
        self._whole |= {queue}
        while self._take(self._zero_ns):
            pass

    def _read_clocks(self, zero_ns: int) -> None:
        """Compute the time zero by the system's clock, which the packets' time stamps use."""
        self._clock_zero_ns = time.time_ns() - time.monotonic_ns() + zero_ns

    def _take(self, zero_ns: int) -> bool:
        """Take packets that have arrived, at most BATCH; returns whether there may be more."""
        receive, buffer, push, stamp = self._socket.recv_into, self._buffer, heapq.heappush, nfqueue.STAMP.unpack_from
        links, held, accept, drop = self._links, self._held, self._accept, self._drop
        kind, short, numbers = nfqueue.PACKET_KIND, nfqueue.SHORT_PAYLOAD, self._numbers
        stamp_head, clock_zero_ns = nfqueue.STAMP_HEAD, self._clock_zero_ns
        now_ns = time.monotonic_ns() - zero_ns
        earliest_ns, latest_ns = now_ns - STAMP_LIMIT_NS, now_ns + STAMP_LIMIT_NS
        for _ in range(BATCH):
            try:
                end = receive(buffer)
            except BlockingIOError:
                return False
            except OSError as error:
                if error.errno != errno.ENOBUFS:
                    raise
                self.overruns += 1
                continue
            if buffer[4:6] != kind:  # an answer to a verdict on a packet that vanished with its interface
                continue
            queue = buffer[18] << 8 | buffer[19]
            packet = bytes(buffer[24:28])
            if buffer[64:68] == stamp_head:
                seconds, microseconds = stamp(buffer, 68)
                came_ns = seconds * 1_000_000_000 + microseconds * 1000 - clock_zero_ns
            else:
                came_ns = (nfqueue.stamp_of(bytes(buffer[:end])) or 0) - clock_zero_ns
            if not earliest_ns < came_ns < latest_ns:  # no time stamp, or the system's clock was set
                came_ns = time.monotonic_ns() - zero_ns
            if buffer[end - 8 : end - 4] != short:
                self._take_whole(queue, packet, nfqueue.payload_of(bytes(buffer[:end])), came_ns)
                continue
            link = links[queue]
            size = (buffer[end - 2] << 8 | buffer[end - 1]) + ETHERNET_BYTES
            due_ns, fate = link.arrive(came_ns, size)
            if fate > 0:
                push(held, (due_ns, next(numbers), link.counters, accept[queue] + packet, None))
            elif fate == DROP:
                push(held, (due_ns, next(numbers), None, drop[queue] + packet, None))
            else:
                self._waiting[link].append((queue, packet, b""))
        return True

    def _take_whole(self, queue: int, packet: bytes, payload: bytes, came_ns: int) -> None:
        """Take a packet of a link that may corrupt or duplicate it."""
        link = self._links[queue]
        due_ns, fate = link.arrive(came_ns, len(payload) + ETHERNET_BYTES)
        if fate == WAIT:
            self._waiting[link].append((queue, packet, payload))
        else:
            self._hold(queue, packet, payload, due_ns, fate)

    def _take_turns(self, now_ns: int) -> None:
        """Hold the packets whose sending has begun on links that share a rate."""
        for turns in self._network.turns:
            for link, due_ns, fate in turns.advance(now_ns):
                queue, packet, payload = self._waiting[link].popleft()
                self._hold(queue, packet, payload, due_ns, fate)

    def _hold(self, queue: int, packet: bytes, payload: bytes, due_ns: int, fate: int) -> None:
        """Hold a packet until it is due; `payload` is set if the link may corrupt or duplicate it."""
        link, numbers = self._links[queue], self._numbers
        if fate == DROP:
            heapq.heappush(self._held, (due_ns, next(numbers), None, self._drop[queue] + packet, None))
            return
        verdict = self._accept[queue] + packet
        if fate & CORRUPT:
            verdict = nfqueue.verdict_with(queue, packet, self._corrupted(payload))
        heapq.heappush(self._held, (due_ns, next(numbers), link.counters, verdict, None))
        if fate & DUPLICATE:
            due_ns, fate = link.copy()
            if fate & PASS:
                copy = (self._injectors[queue], self._corrupted(payload) if fate & CORRUPT else payload)
                heapq.heappush(self._held, (due_ns, next(numbers), link.counters, b"", copy))

    def _corrupted(self, payload: bytes) -> bytes:
        """The packet with one bit flipped, anywhere in it, as by netem."""
        changed = bytearray(payload)
        changed[self._flips.randrange(len(changed))] ^= 1 << self._flips.randrange(8)
        return bytes(changed)

    def _let_go(self, zero_ns: int) -> None:
        """Release the packets that are due."""
        held, pop, late = self._held, heapq.heappop, self.late.add
        now_ns = time.monotonic_ns() - zero_ns
        verdicts: list[bytes] = []
        while held and held[0][0] <= now_ns:
            due_ns, _, counters, verdict, copy = pop(held)
            if counters is not None:
                counters.left += 1
                late(now_ns - due_ns)
            if copy is not None:
                if not copy[0].send(copy[1]) and counters is not None:
                    counters.left -= 1
                    counters.refused += 1
            else:
                verdicts.append(verdict)
                if len(verdicts) == BATCH:
                    self._socket.send(b"".join(verdicts))
                    verdicts = []
                    now_ns = time.monotonic_ns() - zero_ns
        if verdicts:
            self._socket.send(b"".join(verdicts))
