"""Tens of thousands of commands in simulated fogs under attack: python -m tests.bench.deadlines [HISTORIES] [SEED].

Each history has its own seed; the adversary is that of tests/unit/mqttxt/test_deadlines.py, for longer.
"""

from __future__ import annotations

import sys
from collections import Counter

from tests.simulation.adversary import Simulation

SECONDS = 60


def measure(histories: int = 50, first: int = 1000) -> list[str]:
    """The counts over all histories, and the largest lateness and earliness by true time."""
    total: Counter[str] = Counter()
    late_ms = early_ms = 0.0
    sentences: list[str] = []
    for seed in range(first, first + histories):
        judge = Simulation(seed, qos=seed % 2).live(SECONDS)
        total += judge.counts()
        late_ms, early_ms = max(late_ms, judge.worst_late_ms), max(early_ms, judge.worst_early_ms)
        sentences += [f"seed {seed}: {kind}: {one}" for kind, found in judge.violations.items() for one in found[:3]]
    words = ", ".join(f"{name} {count}" for name, count in total.most_common())
    return [
        f"deadlines, simulated: {histories} histories of {SECONDS} s: {words}",
        f"  latest execution past its deadline: {late_ms:.3f} ms; earliest refusal before it: {early_ms:.1f} ms",
        *sentences,
    ]


def main() -> None:
    print("\n".join(measure(*(int(argument) for argument in sys.argv[1:3]))))


if __name__ == "__main__":
    main()
