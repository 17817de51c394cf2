"""Reads mavp2p's log: the nodes that it hears, and the lines that are worth showing."""

from __future__ import annotations

import re
from collections import Counter

_STARTED = re.compile(r"router started with \d+ endpoints?$")
_APPEARED = re.compile(r"node appeared: chan=(\S+) sid=(\d+) cid=1$")
_GONE = re.compile(r"node disappeared: chan=(\S+) sid=(\d+) cid=1$")
_VARIES = re.compile(r"^\S+ \S+ |\S+:\d+->")
"""Differs between repeated lines: the date, and the source port of a closed channel."""


class Heard:
    """The state of one mavp2p, from its log: whether it listens, and the autopilots (component 1) that it knows now."""

    def __init__(self) -> None:
        self.listening = False
        self._channels: dict[int, set[str]] = {}
        self._said: Counter[str] = Counter()

    def line(self, text: str) -> bool:
        """Take a log line; returns whether to show it.

        Repeated lines are shown once: mavp2p writes one for every command to a system that it has not heard, and two
        every 2 s while nothing listens at its destination.
        """
        if _STARTED.search(text):  # logged once its sockets are bound
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
