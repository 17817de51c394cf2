"""Copies of MAVLink frames that a link made: a doubled acknowledgement would answer the next command."""

from __future__ import annotations

from collections import OrderedDict

REMEMBERED_S = 3.0
"""As long as a late acknowledgement is waited for; a sender's number comes again after 256 frames."""


class Repeats:
    """The frames of the last seconds. Senders number their frames, so that equal ones are one frame."""

    def __init__(self) -> None:
        self._heard_s: OrderedDict[bytes, float] = OrderedDict()

    def is_copy(self, frame: bytes, now_s: float) -> bool:
        """Whether the same bytes came a moment ago; they are remembered from their first time on."""
        while self._heard_s and now_s - next(iter(self._heard_s.values())) > REMEMBERED_S:
            self._heard_s.popitem(last=False)
        if frame in self._heard_s:
            return True
        self._heard_s[frame] = now_s
        return False
