"""Which ground station a session number belongs to (docs/protocol.md, R12.7)."""

from __future__ import annotations

from collections.abc import Callable

MOST_OF_ONE = 64
"""Sessions of one station, those with the newest births: one for each start of its process."""


class SessionOwners:
    """The first station whose signature names a session has it: ids, order and control are kept by session.

    What `is_in_use` is never forgotten: births that a broker repeats would give it to another station otherwise.
    """

    def __init__(self, is_in_use: Callable[[int], bool] = lambda session: False) -> None:
        self._owners: dict[int, str] = {}
        self._is_in_use = is_in_use

    def claim(self, session: int, station: str) -> bool:
        """Whether a session is this station's, from now on if it was nobody's."""
        if self._owners.setdefault(session, station) != station:
            return False
        self._owners[session] = self._owners.pop(session)  # in the order of their newest births
        own = [known for known, owner in self._owners.items() if owner == station]
        for forgotten in own[:-MOST_OF_ONE]:
            if not self._is_in_use(forgotten):
                del self._owners[forgotten]
        return True

    def restore(self, session: int, station: str) -> None:
        """A session's owner in the words of the fog's activator, whoever has claimed the session meanwhile."""
        self._owners[session] = station

    def owner(self, session: int) -> str | None:
        """The station whose session it is, as its certificate names it."""
        return self._owners.get(session)

    def is_of(self, session: int, station: str) -> bool:
        return self._owners.get(session) == station
