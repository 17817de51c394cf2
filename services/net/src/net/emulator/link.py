"""One directed link: when an arriving frame leaves, and its fate. No I/O; times are passed in.

Two stages, as in the kernel: first the rate with its own queue, then delay, jitter, loss, duplication, corruption and
reordering. Frames that wait for their delay do not fill the queue.

A frame leaves the rate stage when its last bit is sent: `size * 8 / rate` after its arrival or after the frame before.
Loss, duplication, corruption and reordering are drawn for each frame, with netem's meaning (sch_netem.c): a copy has
its own delay and draws, a frame that is both lost and duplicated passes once and counts as neither, a frame chosen by
`reorder` skips its delay.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from .jitter import Jitter, generator, make_jitter
from .plan import Settings
from .turns import Turns

DROP, PASS, CORRUPT, DUPLICATE, WAIT = 0, 1, 2, 4, -1
"""A frame's fate: DROP, PASS with CORRUPT and DUPLICATE added, or WAIT for its turn if two links share a rate."""
_NS = 1_000_000_000


@dataclass(slots=True)
class Counters:
    """A link's counts, in frames (and bytes of Ethernet frames without FCS).

    entered + duplicated = left + queue + random + closed + refused + frames in flight. `refused` counts copies that the
    kernel did not accept (a flipped bit can make a header invalid). `overload` counts packets that the kernel dropped
    because the emulator did not keep up: they are not in `entered`.
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


class EmulatedLink:
    """A link's state; call `arrive` for each frame, in the order of arrival."""

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
        """When the last frame in the rate stage left it, or will leave it."""
        self._last_ns = 0
        self._zero_ns = 0
        self._draw = generator(seed, name, "frames").random
        self._jitter: Jitter
        self.change(settings)

    def change(self, settings: Settings) -> None:
        """Change the settings; frames that arrived before keep their times."""
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
        """Start the link's clock: jitter counts time from here, and the draws for frames begin anew."""
        self._zero_ns = at_ns
        self._draw = generator(self._seed, self.name, "frames since the start").random

    def arrive(self, now_ns: int, size: int) -> tuple[int, int]:
        """When a frame of `size` bytes leaves, and its fate.

        A frame to be dropped has the time of the last one before it: the kernel finds packets fastest in the order of
        arrival. If two links share a rate, the fate is WAIT until `Turns.advance` returns another.
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
        """Begin to send a frame at this link's turn; returns when its last bit is sent."""
        self._free_ns = start_ns + (size * 8 * _NS // self._rate_bps if self._rate_bps is not None else 0)
        return self._free_ns

    def finish(self, sent_ns: int) -> tuple[int, int]:
        """When a frame whose last bit is sent at `sent_ns` leaves, and its fate."""
        self.sent_ns = sent_ns
        return self._second_stage(sent_ns) if self._draws else (self._due_ns(sent_ns), PASS)

    def copy(self) -> tuple[int, int]:
        """When the copy of the frame finished last leaves, and its fate; a copy is not duplicated again."""
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
        if lost and not doubled:
            counters.random += 1
            return max(sent_ns, self._last_ns), DROP
        if doubled and not lost:
            counters.duplicated += 1
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
