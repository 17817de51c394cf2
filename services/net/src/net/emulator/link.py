"""One directed link: when a frame that comes now leaves, and what becomes of it. No I/O; times are passed in.

Two stages, as with the kernel's: first the rate with a queue of its own, then delay, jitter, loss, duplication,
corruption and reordering. What waits for its delay does not fill the queue.

A frame leaves the rate stage when its last bit is sent: `size * 8 / rate` after it or the one before. Loss,
duplication, corruption and reordering are drawn for each frame, with netem's meaning (sch_netem.c): a copy has a delay
and chances of its own, a frame that is lost and duplicated at once goes on once, a frame chosen by `reorder`
skips its delay.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from .jitter import Jitter, generator, make_jitter
from .plan import Settings
from .turns import Turns

DROP, PASS, CORRUPT, DUPLICATE, WAIT = 0, 1, 2, 4, -1
"""A frame's fate: DROP, PASS with CORRUPT and DUPLICATE added, or WAIT for its turn where two links share a rate."""
_NS = 1_000_000_000


@dataclass(slots=True)
class Counters:
    """What a link did, in frames (and bytes of Ethernet frames without FCS).

    entered + duplicated = left + queue + random + closed + refused + what is in flight. `refused` are copies that the
    kernel did not take (a turned bit can make a header senseless). `overload` is what the kernel dropped because the
    emulator did not keep up: it is not in `entered`.
    """

    entered: int = 0
    entered_bytes: int = 0
    left: int = 0
    queue: int = 0
    random: int = 0
    closed: int = 0
    refused: int = 0
    overload: int = 0
    duplicated: int = 0
    corrupted: int = 0
    reordered: int = 0


class Link:
    """`arrive` for each frame in the order in which they come."""

    def __init__(self, name: str, settings: Settings, seed: int, turns: Turns | None = None) -> None:
        self.name = name
        self.counters = Counters()
        self.settings = settings
        self._seed = seed
        self._turns = turns
        self._free_ns = 0
        self._leaving: deque[int] = deque()
        """When each frame in the rate stage leaves it."""
        self.sent_ns = 0
        """When the frame that was last in the rate stage left it, or will."""
        self._last_ns = 0
        self._zero_ns = 0
        self._draw = generator(seed, name, "frames").random
        self._jitter: Jitter
        self.change(settings)

    def change(self, settings: Settings) -> None:
        """Frames that came before keep their times."""
        self.settings = settings
        self._closed = settings.closed
        self._rate_bps = settings.rate_bps
        self._room = settings.queue_packets
        self._delay_ns = settings.delay_us * 1000
        self._keeps_order = not settings.reordering
        self._loss, self._duplicate = settings.loss, settings.duplicate
        self._corrupt, self._reorder = settings.corrupt, settings.reorder
        self._draws = bool(settings.loss or settings.duplicate or settings.corrupt or settings.reorder)
        self._jitter = make_jitter(
            settings.distribution, settings.jitter_us * 1000, settings.reordering, self._seed, self.name
        )

    def start(self, at_ns: int) -> None:
        """From here on jitter is what it is that long after a start, and frames are drawn for anew."""
        self._zero_ns = at_ns
        self._draw = generator(self._seed, self.name, "frames since the start").random

    def arrive(self, now_ns: int, size: int) -> tuple[int, int]:
        """When a frame of `size` bytes leaves, and its fate.

        A frame to be dropped has the time of the last before it: the kernel finds packets fastest in the order in
        which they came. Where two links share a rate the fate is WAIT, until `Turns.advance` says another.
        """
        counters = self.counters
        counters.entered += 1
        counters.entered_bytes += size
        if self._closed:
            counters.closed += 1
            return max(now_ns, self._last_ns), DROP
        if self._turns is not None:
            return self._await_turn(self._turns, now_ns, size)
        sent_ns = now_ns
        if self._rate_bps is not None:
            leaving = self._leaving
            while leaving and leaving[0] <= now_ns:
                leaving.popleft()
            if self._room is not None and len(leaving) >= self._room:
                counters.queue += 1
                return max(now_ns, self._last_ns), DROP
            sent_ns = (self._free_ns if self._free_ns > now_ns else now_ns) + size * 8 * _NS // self._rate_bps
            self._free_ns = sent_ns
            leaving.append(sent_ns)
        return self.finish(sent_ns)

    def begin(self, start_ns: int, size: int) -> int:
        """It is this link's turn to send; when the last bit is sent."""
        self._free_ns = start_ns + (size * 8 * _NS // self._rate_bps if self._rate_bps is not None else 0)
        return self._free_ns

    def finish(self, sent_ns: int) -> tuple[int, int]:
        """When a frame leaves whose last bit is sent at `sent_ns`, and its fate."""
        self.sent_ns = sent_ns
        return self._second_stage(sent_ns) if self._draws else (self._due_ns(sent_ns), PASS)

    def copy(self) -> tuple[int, int]:
        """When the copy of the frame that finished last leaves, and its fate; it is not duplicated again."""
        counters, sent_ns = self.counters, self.sent_ns
        if self._draw() < self._loss:
            counters.random += 1
            return max(sent_ns, self._last_ns), DROP
        fate = PASS
        if self._draw() < self._corrupt:
            counters.corrupted += 1
            fate |= CORRUPT
        if self._draw() < self._reorder:
            counters.reordered += 1
            return sent_ns, fate
        return self._due_ns(sent_ns), fate

    def _await_turn(self, turns: Turns, now_ns: int, size: int) -> tuple[int, int]:
        if self._room is not None and turns.waiting(self) + (self._free_ns > now_ns) >= self._room:
            self.counters.queue += 1
            return max(now_ns, self._last_ns), DROP
        turns.offer(self, now_ns, size)
        return now_ns, WAIT

    def _second_stage(self, sent_ns: int) -> tuple[int, int]:
        counters, draw = self.counters, self._draw
        fate = PASS
        lost = self._loss > 0.0 and draw() < self._loss
        doubled = self._duplicate > 0.0 and draw() < self._duplicate
        if doubled:
            counters.duplicated += 1
        if lost:
            counters.random += 1
            if not doubled:
                return max(sent_ns, self._last_ns), DROP
        elif doubled:
            fate |= DUPLICATE
        if self._corrupt and draw() < self._corrupt:
            counters.corrupted += 1
            fate |= CORRUPT
        if self._reorder and draw() < self._reorder:
            counters.reordered += 1
            return sent_ns, fate
        return self._due_ns(sent_ns), fate

    def _due_ns(self, sent_ns: int) -> int:
        due_ns = sent_ns + self._delay_ns + self._jitter(sent_ns - self._zero_ns)
        if due_ns < sent_ns:
            due_ns = sent_ns
        if due_ns > self._last_ns:
            self._last_ns = due_ns
        elif self._keeps_order:
            return self._last_ns
        return due_ns
