"""Whether a broker still answers: when to send a PINGREQ, and how long its answer may take."""

from __future__ import annotations

from .round_trip import RoundTrip


class KeepAlive:
    """The pings of one connection; times are seconds of the event loop's clock."""

    def __init__(self) -> None:
        self.heard_s = 0.0
        """Time at which bytes last arrived."""
        self._asked_s: float | None = None
        self._round_trip = RoundTrip()

    @property
    def is_owed(self) -> bool:
        """Whether a PINGREQ is unanswered."""
        return self._asked_s is not None

    def ask(self, now_s: float) -> None:
        """A PINGREQ is sent."""
        self._asked_s = now_s

    def answered(self, now_s: float) -> None:
        """A PINGRESP arrived."""
        if self._asked_s is not None:
            self._round_trip.took(now_s - self._asked_s)
        self._asked_s = None

    def usual_s(self, now_s: float) -> float:
        """The usual upper bound of the broker's round trip, s; infinite if an answer is overdue."""
        return self._round_trip.usual_s(now_s - self._asked_s if self._asked_s is not None else 0.0)

    def is_lost(self, now_s: float, patience_s: float) -> bool:
        return self._asked_s is not None and now_s - self._asked_s >= patience_s

    def is_due(self, now_s: float, wrote_s: float, patience_s: float) -> bool:
        """Whether to send a PINGREQ: after `patience_s` of silence in either direction. `wrote_s`: the last write."""
        return self._asked_s is None and now_s - min(self.heard_s, wrote_s) >= patience_s
