"""Copies of acknowledgements that a link made: a doubled one would answer the next command.

Of other messages nothing is dropped. A sender has 256 numbers, and PX4 uses them up in half a second: what is sent
again and again in the same words, as a heartbeat is, comes under the same number too.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

REMEMBERED_S = 3.0
"""As long as a late acknowledgement is waited for."""


class Repeats:
    """The COMMAND_ACKs of the last seconds. Senders number their frames, so that equal ones are one frame."""

    def __init__(self) -> None:
        self._heard_s: OrderedDict[bytes, float] = OrderedDict()

    def is_copy(self, message: Any, now_s: float) -> bool:
        """Whether it is an acknowledgement whose bytes came a moment ago; they are remembered from then on."""
        if message.get_type() != "COMMAND_ACK":
            return False
        frame = bytes(message.get_msgbuf())
        while self._heard_s and now_s - next(iter(self._heard_s.values())) > REMEMBERED_S:
            self._heard_s.popitem(last=False)
        if frame in self._heard_s:
            return True
        self._heard_s[frame] = now_s
        return False
