"""Whether a client is still there, asked because somebody else came with its id or its drone (R20.10)."""

from __future__ import annotations

from math import inf

ASK_S, ASK_TIMES = 5.0, 4
"""How long a client whose id or drone somebody else names may take to answer, and how often it is asked meanwhile."""


class Challenge:
    """Asked by PINGREQ, `ASK_TIMES` within `ASK_S`. Times are seconds of one clock."""

    def __init__(self) -> None:
        self._asked_s: float | None = None
        self._times = 0
        self._is_asked_again = False

    @property
    def is_open(self) -> bool:
        """Whether the client has been asked, and not answered."""
        return self._asked_s is not None

    def begin(self, now_s: float) -> bool:
        """Somebody else came; whether that is the first time since the client said something."""
        self._is_asked_again = self.is_open
        if self._asked_s is None:
            self._asked_s, self._times = now_s, 1
        return not self._is_asked_again

    def answered(self) -> None:
        """The client has said something."""
        self._asked_s = None

    def asks_again(self, now_s: float) -> bool:
        """Whether to ask once more; who came once alone, and did not come again, is forgotten at last."""
        if now_s < self.due_s():
            return False
        if self._times < ASK_TIMES:
            self._times += 1
            return True
        if not self._is_asked_again:
            self.answered()
        return False

    def due_s(self) -> float:
        """When `asks_again` has something to do."""
        return inf if self._asked_s is None else self._asked_s + self._times * ASK_S / ASK_TIMES

    def over_s(self) -> float:
        """When the client is given up."""
        return inf if self._asked_s is None else self._asked_s + ASK_S
