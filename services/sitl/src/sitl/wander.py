"""An estimator's errors, which wander about the truth: noise with a memory, larger or smaller while the drone flies."""

from __future__ import annotations

import math
import random

FRESH_S = 0.04
"""An error does not change within this time."""


class Wander:
    """One value's error, normally distributed: standard deviation `at_rest` or `flying`, kept for about `memory_s`.

    An Ornstein-Uhlenbeck process, which can be sampled at any times.
    """

    def __init__(self, source: random.Random, at_rest: float, flying: float, memory_s: float) -> None:
        self._random = source
        self._sizes = (at_rest, flying)
        self._memory_s = memory_s
        self._at_s = -math.inf
        self._value = 0.0

    def at(self, now_s: float, flies: bool) -> float:
        """The error at `now_s`, which never decreases from call to call."""
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
        """Always 0."""
        return 0.0
