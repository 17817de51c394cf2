"""A histogram of how late packets are released: the emulator's own precision."""

from __future__ import annotations

STEP_NS = 10_000
STEPS = 2_000


class Lateness:
    """Counts in steps of 10 microseconds up to 20 ms; the maximum is exact."""

    __slots__ = ("_counts", "greatest_ns")

    def __init__(self) -> None:
        self._counts = [0] * (STEPS + 1)
        self.greatest_ns = 0

    def add(self, late_ns: int) -> None:
        step = late_ns // STEP_NS
        self._counts[step if step < STEPS else STEPS] += 1
        if late_ns > self.greatest_ns:
            self.greatest_ns = late_ns

    def quantile_ms(self, share: float) -> float:
        """The lateness in ms that `share` of packets did not exceed; beyond the last step the maximum; 0 if none."""
        wanted, seen = share * sum(self._counts), 0
        for step, count in enumerate(self._counts):
            seen += count
            if count and seen >= wanted:
                return (min((step + 1) * STEP_NS, self.greatest_ns) if step < STEPS else self.greatest_ns) / 1e6
        return 0.0
