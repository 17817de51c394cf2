"""What ground stations have granted themselves at this drone: an activator can give less, never more (R12.14)."""

from __future__ import annotations

from ..protocol.control import Grant

MOST_GRANTS = 64
"""Of stations' sessions, the newest."""


class Grants:
    """For each station and session the latest end of its control that it has signed, in the drone's clock."""

    def __init__(self) -> None:
        self._until_ms: dict[tuple[str | None, int | None], tuple[int, int]] = {}

    def take(self, station: str, grant: Grant) -> None:
        """Keep the ends of a station's grant where they are later than those before: an old one changes nothing."""
        until_ms, offboard_ms = self._until_ms.pop((station, grant.gs_session), (0, 0))
        ends = max(until_ms, grant.until_ms), max(offboard_ms, grant.offboard_until_ms or 0)
        self._until_ms[station, grant.gs_session] = ends
        while len(self._until_ms) > MOST_GRANTS:
            del self._until_ms[next(iter(self._until_ms))]

    def bound(
        self, station: str | None, gs_session: int | None, until_ms: int | None, offboard_ms: int | None
    ) -> tuple[int | None, int | None]:
        """The ends of a lease and of what it allows to an offboard command, where the station has granted them."""
        granted = self._until_ms.get((station, gs_session))
        if granted is None:
            return None, None
        return _earlier(until_ms, granted[0]), _earlier(offboard_ms, granted[1])


def _earlier(end_ms: int | None, granted_ms: int) -> int | None:
    return None if end_ms is None else min(end_ms, granted_ms)
