"""Recognises copies of acknowledgements that a link made: a duplicate would answer the next command.

No other message is dropped. A sender has 256 sequence numbers, and PX4 uses them up in half a second, so repeated
messages with equal contents, such as heartbeats, also get equal numbers.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

REMEMBERED_S = 3.0
"""As long as a number rests for late acknowledgements."""


class Repeats:
    """The COMMAND_ACKs of the last seconds. Senders number their frames, so equal ones are copies of one frame."""

    def __init__(self) -> None:
        self._heard_s: OrderedDict[bytes, float] = OrderedDict()

    def is_copy(self, message: Any, now_s: float) -> bool:
        """Whether it is a COMMAND_ACK equal to one of the last `REMEMBERED_S`; a new one is remembered."""
        if message.get_type() != "COMMAND_ACK":
            return False
        frame = bytes(message.get_msgbuf())
        while self._heard_s and now_s - next(iter(self._heard_s.values())) > REMEMBERED_S:
            self._heard_s.popitem(last=False)
        if frame in self._heard_s:
            return True
        self._heard_s[frame] = now_s
        return False
