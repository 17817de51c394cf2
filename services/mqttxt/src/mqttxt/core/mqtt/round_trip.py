"""The round trip of a PINGREQ to a broker; over TCP a lost segment shows as a late answer."""

from __future__ import annotations

from math import inf

FIRST_S = 1.0
"""The assumed round trip of a connection before its first answer."""
SPARE_S = 0.15
"""How much later than usual an answer may arrive before its connection counts as stuck."""


class RoundTrip:
    """Smoothed round trip and its variation, computed as for TCP's retransmission timer (RFC 6298, section 2)."""

    def __init__(self) -> None:
        self._smoothed_s: float | None = None
        self._varies_s = 0.0

    @property
    def is_known(self) -> bool:
        """Whether an answer has arrived yet."""
        return self._smoothed_s is not None

    def took(self, round_trip_s: float) -> None:
        """Add a measured round trip."""
        if self._smoothed_s is None:
            self._smoothed_s, self._varies_s = round_trip_s, round_trip_s / 2
            return
        self._varies_s += (abs(self._smoothed_s - round_trip_s) - self._varies_s) / 4
        self._smoothed_s += (round_trip_s - self._smoothed_s) / 8

    def usual_s(self, waits_s: float) -> float:
        """The usual upper bound of a round trip, s; infinite if an answer awaited for `waits_s` is overdue."""
        if self._smoothed_s is None:
            return FIRST_S if waits_s <= FIRST_S else inf
        usual_s = self._smoothed_s + 4 * self._varies_s
        return usual_s if waits_s <= usual_s + SPARE_S else inf
