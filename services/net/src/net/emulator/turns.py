"""A rate that two links share, as the two directions of a half-duplex radio: one frame at a time, in turns. No I/O.

Each link has its queue at its own sender. A frame waits for those before it on its own link and, if both have frames,
for the other link's turn in between: an overfull link does not shut out the other. Turns are counted in bytes, not in
frames, or the link with the larger frames would get more of the rate. It is deficit round robin with HTB's accounting
(htb_dequeue_tree in sch_htb.c), since the kernel's links share their rate by HTB.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Protocol

QUANTUM_BYTES = 1514
"""The bytes that a link may send per turn: a full frame, as in the kernel's classes."""


class Sender(Protocol):
    """A link, as it sends at its turn."""

    def begin(self, start_ns: int, size: int) -> int:
        """Begin to send a frame; returns when its last bit is sent."""
        ...

    def finish(self, sent_ns: int) -> tuple[int, int]:
        """When the frame leaves after the stages that follow, and its fate."""
        ...


class Turns:
    """The turns of two links. `offer` each frame as it arrives; call `advance` at `next_ns`, and after every offer."""

    def __init__(self) -> None:
        self._waiting: dict[Sender, deque[tuple[int, int]]] = {}
        """By link the arrival time and the size of each waiting frame."""
        self._free_ns = 0
        self._credit: dict[Sender, int] = {}
        """The bytes left of each link's turn."""
        self._passed: Sender | None = None
        """The link whose turn has just ended."""

    def offer(self, link: Sender, now_ns: int, size: int) -> None:
        self._waiting.setdefault(link, deque()).append((now_ns, size))

    def waiting(self, link: Sender) -> int:
        """The number of frames that are not being sent yet."""
        return len(self._waiting.get(link, ()))

    @property
    def next_ns(self) -> int | None:
        """When the next frame begins to be sent; None if no frame waits."""
        came_ns = min((queue[0][0] for queue in self._waiting.values() if queue), default=None)
        return None if came_ns is None else max(came_ns, self._free_ns)

    def advance(self, now_ns: int) -> Iterator[tuple[Sender, int, int]]:
        """The frames whose sending began until now: link, when each leaves, and its fate; in order for each link."""
        while (start_ns := self.next_ns) is not None and start_ns <= now_ns:
            ready = [link for link, queue in self._waiting.items() if queue and queue[0][0] <= start_ns]
            link = next((link for link in ready if link is not self._passed), ready[0])
            _, size = self._waiting[link].popleft()
            self._free_ns = link.begin(start_ns, size)
            self._credit[link] = self._credit.get(link, 0) - size
            ends = self._credit[link] < 0
            if ends:
                self._credit[link] += QUANTUM_BYTES
            self._passed = link if ends else next((other for other in self._waiting if other is not link), None)
            yield (link, *link.finish(self._free_ns))
