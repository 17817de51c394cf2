"""Checks whether a client is still present, after a newcomer named its id or its drone (R20.10)."""

from __future__ import annotations

from math import inf

ASK_S, ASK_TIMES = 5.0, 4
"""How long such a client may take to answer, and how many PINGREQs it is sent meanwhile."""


class Challenge:
    """The challenge of one client: `ASK_TIMES` PINGREQs within `ASK_S`. Times are seconds of one clock."""

    def __init__(self) -> None:
        self._asked_s: float | None = None
        self._times = 0
        self._is_asked_again = False

    @property
    def is_open(self) -> bool:
        """Whether the client has been challenged and has not answered."""
        return self._asked_s is not None

    def begin(self, now_s: float) -> bool:
        """A newcomer appeared; returns whether it is the first since the client last sent a packet."""
        self._is_asked_again = self.is_open
        if self._asked_s is None:
            self._asked_s, self._times = now_s, 1
        return not self._is_asked_again

    def answered(self) -> None:
        """The client has sent a packet."""
        self._asked_s = None

    def asks_again(self, now_s: float) -> bool:
        """Whether to send another PINGREQ; a newcomer that appeared only once is forgotten in the end."""
        if now_s < self.due_s():
            return False
        if self._times < ASK_TIMES:
            self._times += 1
            return True
        if not self._is_asked_again:
            self.answered()
        return False

    def due_s(self) -> float:
        """When to call `asks_again` next; infinite without a challenge."""
        return inf if self._asked_s is None else self._asked_s + self._times * ASK_S / ASK_TIMES

    def over_s(self) -> float:
        """When the client is given up; infinite without a challenge."""
        return inf if self._asked_s is None else self._asked_s + ASK_S
