"""A rate that two links share, as both ways of a half-duplex radio do: one frame at a time, in turns. No I/O.

Each link has its queue at its own sender, so a frame waits for what is before it on its own link and, where both have
frames, for the other's turn in between: a link that is overfull does not shut the other out. A turn is bytes and not
frames, or the link with the larger frames would have more of the rate: deficit round robin with HTB's reckoning
(htb_dequeue_tree in sch_htb.c), since the kernel's links share their rate by HTB.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Protocol

QUANTUM_BYTES = 1514
"""What a turn lets a link send: a full frame, as in the kernel's classes."""


class Sender(Protocol):
    """What a link does once it may send."""

    def begin(self, start_ns: int, size: int) -> int:
        """Send a frame; when its last bit is sent."""
        ...

    def finish(self, sent_ns: int) -> tuple[int, int]:
        """When it leaves after the stages that follow, and its fate."""
        ...


class Turns:
    """`offer` each frame as it comes; `advance` at `next_ns`, and after every offer, returns those that were sent."""

    def __init__(self) -> None:
        self._waiting: dict[Sender, deque[tuple[int, int]]] = {}
        """When each came, and its size."""
        self._free_ns = 0
        self._credit: dict[Sender, int] = {}
        """Bytes that are left of each link's turn."""
        self._passed: Sender | None = None
        """The link whose turn has just ended."""

    def offer(self, link: Sender, now_ns: int, size: int) -> None:
        self._waiting.setdefault(link, deque()).append((now_ns, size))

    def waiting(self, link: Sender) -> int:
        """Frames that are not yet being sent."""
        return len(self._waiting.get(link, ()))

    @property
    def next_ns(self) -> int | None:
        """When the next frame begins to be sent; None while none waits."""
        came_ns = min((queue[0][0] for queue in self._waiting.values() if queue), default=None)
        return None if came_ns is None else max(came_ns, self._free_ns)

    def advance(self, now_ns: int) -> Iterator[tuple[Sender, int, int]]:
        """The frames that began to be sent until now: link, when each leaves, and its fate; each link's in order."""
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
