"""How an estimator's values wander about the truth: noise with a memory, which depends on whether the drone flies."""

from __future__ import annotations

import math
import random

FRESH_S = 0.04
"""Asked sooner than this it has not changed."""


class Wander:
    """One value's error: normally distributed, `at_rest` or `flying` its standard deviation, kept for about `memory_s`.

    The Ornstein-Uhlenbeck process, which can be asked at any times.
    """

    def __init__(self, source: random.Random, at_rest: float, flying: float, memory_s: float) -> None:
        self._random = source
        self._sizes = (at_rest, flying)
        self._memory_s = memory_s
        self._at_s = -math.inf
        self._value = 0.0

    def at(self, now_s: float, flies: bool) -> float:
        """The error now; times may not go back."""
        passed_s = now_s - self._at_s
        if passed_s >= FRESH_S:
            self._at_s = now_s
            kept = math.exp(-passed_s / self._memory_s)
            size = self._sizes[flies]
            self._value = self._value * kept + self._random.gauss(0.0, size * math.sqrt(1 - kept * kept))
        return self._value


class Quiet(Wander):
    """No error at all."""

    def __init__(self) -> None:
        super().__init__(random.Random(0), 0.0, 0.0, 1.0)

    def at(self, now_s: float, flies: bool) -> float:
        """Nothing, always."""
        return 0.0
