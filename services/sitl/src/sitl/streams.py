"""When each message of a link is due, and how the receiver changes that."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from pymavlink.dialects.v20 import development as mavlink

from .unnamed import NUMBERS

FASTEST_HZ = 100.0
"""As fast as the stand-in's clock ticks."""
LONGEST_US = 2**31 - 1
"""The longest interval that MESSAGE_INTERVAL can carry."""
LATE_S = 0.1
"""A message that is late by no more than this is still sent; an older one is left out, as after a standstill.

So at most 45 messages are sent at once, which a router's queue of 64 takes.
"""


def number(name: str) -> int:
    """The id of a message."""
    return int(NUMBERS.get(name) or getattr(mavlink, f"MAVLINK_MSG_ID_{name}"))


class Streams:
    """The messages of one link and their rates. `default_hz` has the first rate of every message that it can send.

    `silent` are messages whose interval it accepts, although nothing makes it send them.
    """

    def __init__(self, default_hz: Mapping[str, float], silent: Collection[int] = ()) -> None:
        self._default_hz = default_hz
        self._silent = silent
        self._names = {number(name): name for name in default_hz}
        self._hz = dict(default_hz)
        self._next_s = {name: i / len(default_hz) / max(hz, 1) for i, (name, hz) in enumerate(self._hz.items())}
        """When each message is due next; staggered, so that they do not all fall on one tick."""

    def due(self, now_s: float) -> list[str]:
        """The names of the messages to send now; one that fell due twice since the last call is named twice.

        So late calls, on a busy machine, do not make the streams slower.
        """
        found = []
        for name, next_s in self._next_s.items():
            if next_s > now_s or (hz := self._hz[name]) <= 0:
                continue
            if now_s - next_s > max(LATE_S, 1 / hz):
                self._next_s[name] = now_s
            while self._next_s[name] <= now_s:
                found.append(name)
                self._next_s[name] += 1 / hz
        return found

    def name(self, message_id: int) -> str | None:
        """A message's name; None for one that the autopilot does not have."""
        return self._names.get(message_id)

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL in microseconds: -1 stops, 0 is the default. False for an unknown message, or NaN."""
        name = self._names.get(message_id)
        if name is None or not math.isfinite(interval_us):
            return message_id in self._silent and math.isfinite(interval_us)
        self._next_s[name] = -math.inf  # so late that it is sent now, once
        if interval_us < 0:
            self._hz[name] = 0.0
        elif interval_us == 0:
            self._hz[name] = self._default_hz[name]
        else:
            self._hz[name] = min(1e6 / interval_us, FASTEST_HZ)
        return True

    def interval_us(self, message_id: int) -> int:
        """A message's interval for GET_MESSAGE_INTERVAL, in microseconds: -1 stopped, 0 unknown."""
        name = self._names.get(message_id)
        if name is None:
            return 0
        return round(min(1e6 / self._hz[name], LONGEST_US)) if self._hz[name] > 0 else -1
