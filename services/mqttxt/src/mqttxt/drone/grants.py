"""The grants that ground stations signed for this drone: an activator can shorten them, never extend them (R12.14)."""

from __future__ import annotations

from ..protocol.control import Grant

MOST_GRANTS = 64
"""Sessions of stations whose grants are kept, the newest."""


class Grants:
    """The latest ends of control that each station's session has signed, in ms of the drone's clock."""

    def __init__(self) -> None:
        self._until_ms: dict[tuple[str | None, int | None], tuple[int, int]] = {}

    def take(self, station: str, grant: Grant) -> None:
        """Keep the ends of a station's grant if later than the known ones: an old grant changes nothing."""
        until_ms, offboard_ms = self._until_ms.pop((station, grant.gs_session), (0, 0))
        ends = max(until_ms, grant.until_ms), max(offboard_ms, grant.offboard_until_ms or 0)
        self._until_ms[station, grant.gs_session] = ends
        while len(self._until_ms) > MOST_GRANTS:
            del self._until_ms[next(iter(self._until_ms))]

    def bound(
        self, station: str | None, gs_session: int | None, until_ms: int | None, offboard_ms: int | None
    ) -> tuple[int | None, int | None]:
        """The ends of a lease and of its offboard commands, each at most the granted one; None without a grant."""
        granted = self._until_ms.get((station, gs_session))
        if granted is None:
            return None, None
        return _earlier(until_ms, granted[0]), _earlier(offboard_ms, granted[1])


def _earlier(end_ms: int | None, granted_ms: int) -> int | None:
    return None if end_ms is None else min(end_ms, granted_ms)
