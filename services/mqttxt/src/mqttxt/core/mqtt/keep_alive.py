"""Whether a broker still answers: when to send a PINGREQ, and how long its answer, a PUBACK or a SUBACK may take."""

from __future__ import annotations

from .round_trip import RoundTrip

PROOFS = 2
"""PINGRESPs behind which no PUBACK or SUBACK comes any more: the first PINGREQ may have left before the packet."""


class KeepAlive:
    """The pings of one connection; times are seconds of the event loop's clock."""

    def __init__(self) -> None:
        self.heard_s = 0.0
        """Time at which bytes last arrived."""
        self._asked_s: float | None = None
        self._round_trip = RoundTrip()
        self._oldest: int | None = None
        self._looks = self._answers = 0
        """Calls of `is_left_out` with the same packet, and answers since the first of these."""
        self._is_in_doubt = False

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
            self._answers += 1
        self._asked_s = None

    def usual_s(self, now_s: float) -> float:
        """The usual upper bound of the broker's round trip, s; infinite if an answer is overdue."""
        return self._round_trip.usual_s(now_s - self._asked_s if self._asked_s is not None else 0.0)

    def is_lost(self, now_s: float, patience_s: float) -> bool:
        """Whether a PINGREQ was not answered; while bytes come, one asked in doubt may still wait to be sent."""
        if self._asked_s is None:
            return False
        return now_s - (max(self._asked_s, self.heard_s) if self._is_in_doubt else self._asked_s) >= patience_s

    def is_due(self, now_s: float, wrote_s: float, patience_s: float) -> bool:
        """Whether to send a PINGREQ: after `patience_s` of silence in a direction, or if an answer may be left out.

        `wrote_s` is the last write.
        """
        is_quiet = now_s - min(self.heard_s, wrote_s) >= patience_s
        return self._asked_s is None and (is_quiet or self._is_in_doubt)

    def is_left_out(self, oldest: int | None, patience_s: float) -> bool:
        """Whether the broker has dropped the answer to `oldest`, the id of the first packet without PUBACK or SUBACK.

        After `patience_s` that is in doubt, and answered pings decide (R9.18). To be called once a second: a process
        that stood still has counted a second of that time.
        """
        if oldest is None or oldest != self._oldest:
            self._oldest, self._looks, self._answers = oldest, 0, 0
        else:
            self._looks += 1
        self._is_in_doubt = self._looks >= patience_s
        return self._is_in_doubt and self._answers >= PROOFS
