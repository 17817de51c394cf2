"""Which ground station a session number belongs to (docs/protocol.md, R12.7)."""

from __future__ import annotations

from collections.abc import Callable

MOST_OF_ONE = 64
"""Most sessions kept for one station, those with the newest births; each start of its process makes one."""


class SessionOwners:
    """The owner of each session: the first station whose signature named it. Ids, order and control go by session.

    A session for which `is_in_use` returns true is never forgotten: a birth that a broker repeats could otherwise give
    it to another station.
    """

    def __init__(self, is_in_use: Callable[[int], bool] = lambda session: False) -> None:
        self._owners: dict[int, str] = {}
        self._is_in_use = is_in_use

    def claim(self, session: int, station: str) -> bool:
        """Give a session without an owner to `station`; returns whether the session is this station's."""
        if self._owners.setdefault(session, station) != station:
            return False
        self._owners[session] = self._owners.pop(session)  # in the order of their newest births
        own = [known for known, owner in self._owners.items() if owner == station]
        for forgotten in own[:-MOST_OF_ONE]:
            if not self._is_in_use(forgotten):
                del self._owners[forgotten]
        return True

    def restore(self, session: int, station: str) -> None:
        """Set the owner that the fog's activator names for a session, whichever station has claimed it meanwhile."""
        self._owners[session] = station

    def owner(self, session: int) -> str | None:
        """The name, as in the certificate, of the station that owns a session."""
        return self._owners.get(session)

    def is_of(self, session: int, station: str) -> bool:
        return self._owners.get(session) == station
