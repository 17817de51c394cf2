"""Whether a broker still answers: a PINGREQ where it was not spoken to or said nothing, and how long it may take."""

from __future__ import annotations

from .round_trip import RoundTrip


class KeepAlive:
    """What one connection has heard and asked; times are the event loop's, in seconds."""

    def __init__(self) -> None:
        self.heard_s = 0.0
        """When bytes last came."""
        self._asked_s: float | None = None
        self._round_trip = RoundTrip()

    @property
    def is_owed(self) -> bool:
        """Whether a PINGREQ has no answer yet."""
        return self._asked_s is not None

    def ask(self, now_s: float) -> None:
        """A PINGREQ leaves."""
        self._asked_s = now_s

    def answered(self, now_s: float) -> None:
        """A PINGRESP came."""
        if self._asked_s is not None:
            self._round_trip.took(now_s - self._asked_s)
        self._asked_s = None

    def usual_s(self, now_s: float) -> float:
        """By when the broker answers as a rule, in seconds; infinite where an answer is overdue."""
        return self._round_trip.usual_s(now_s - self._asked_s if self._asked_s is not None else 0.0)

    def is_lost(self, now_s: float, patience_s: float) -> bool:
        return self._asked_s is not None and now_s - self._asked_s >= patience_s

    def is_due(self, now_s: float, wrote_s: float, patience_s: float) -> bool:
        """Whether the broker is to be asked; `wrote_s` is when something was last written."""
        return self._asked_s is None and now_s - min(self.heard_s, wrote_s) >= patience_s
