"""How much a drone may be asked at a time: what waits for it delays, or costs it, a command behind that."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable

MOST_UNANSWERED = 8
"""How many unanswered messages each asker may have at a drone; a station that keeps to the rules sends two pieces."""
FORGIVEN_MS = 2000
"""After this an unanswered message counts as lost."""
MOST_KNOWN = 1000
"""Above this number of askers those whose messages are all lost are forgotten."""


class Unanswered:
    """When each asker's unanswered messages were sent. So a flood does not reach a drone's link."""

    def __init__(self) -> None:
        self._sent: dict[Hashable, deque[int]] = {}

    def takes(self, asker: Hashable, now_ms: int) -> bool:
        """Whether one more message may be sent; if so, counts it."""
        sent = self._sent.setdefault(asker, deque())
        while sent and now_ms - sent[0] > FORGIVEN_MS:
            sent.popleft()
        if len(sent) >= MOST_UNANSWERED:
            return False
        sent.append(now_ms)
        if len(self._sent) > MOST_KNOWN:
            self._sent = {one: of for one, of in self._sent.items() if of and now_ms - of[-1] <= FORGIVEN_MS}
        return True

    def answered(self, asker: Hashable) -> None:
        """One of the messages was answered."""
        sent = self._sent.get(asker)
        if sent:
            sent.popleft()
