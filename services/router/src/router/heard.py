"""mavp2p's lines about the nodes that it hears, and which of its lines are worth keeping."""

from __future__ import annotations

import re
from collections import Counter

_STARTED = re.compile(r"router started with \d+ endpoints?$")
_APPEARED = re.compile(r"node appeared: chan=(\S+) sid=(\d+) cid=1$")
_GONE = re.compile(r"node disappeared: chan=(\S+) sid=(\d+) cid=1$")
_VARIES = re.compile(r"^\S+ \S+ |\S+:\d+->")
"""The date, and the port that a channel sent from before it was closed."""


class Heard:
    """What one mavp2p is at, by its log: whether it listens, and the autopilots (component 1) that it knows now."""

    def __init__(self) -> None:
        self.listening = False
        self._channels: dict[int, set[str]] = {}
        self._said: Counter[str] = Counter()

    def line(self, text: str) -> bool:
        """Take a line in; whether it is to be shown.

        What mavp2p repeats is shown once: a line for every command to a system that it has not heard, and two every
        2 s while nobody listens where it sends to.
        """
        if _STARTED.search(text):  # said once its sockets are bound
            self.listening = True
        if found := _APPEARED.search(text):
            self._channels.setdefault(int(found[2]), set()).add(found[1])
            return True
        if found := _GONE.search(text):
            self._channels.get(int(found[2]), set()).discard(found[1])
            return True
        what = _VARIES.sub("", text)
        self._said[what] += 1
        return self._said[what] == 1

    def has(self, drones: tuple[int, ...]) -> bool:
        return all(self._channels.get(drone) for drone in drones)
