"""Brokers and an activator that are the adversary's, against a fleet that signs: none executed, late, or doubled.

What they say is drawn from what passes: replayed, moved to other topics and drones, changed, signed with other keys,
delivered seconds later, rolled back as retained, and denied (0x10) though delivered. Honest commands beside that end in
exactly one last word each.
"""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import replace

import pytest

from tests.simulation.adversary import CALM, Dangers
from tests.simulation.hostile import HostileSimulation

SEEDS = int(os.environ.get("HOSTILE_SEEDS", "2"))
"""Histories of half a minute each. Fourteen are ten thousand attempts at the brokers, and twice that at a thief."""
DANGERS = Dangers(selects=0)
"""A choice by the fog alone is not for a fleet that signs (R12.16)."""
WAYS = {"replayed", "moved", "flipped", "rerouted", "swapped", "altered", "made_up", "rolled back", "said 0x10"}


def attempts(seed: int, thief: bool) -> tuple[Counter[str], int]:
    """What was tried in one history that nothing came of, and how many commands a drone executed beside it."""
    simulation = HostileSimulation(seed, DANGERS, rate=0.3, thief=thief)
    judge = simulation.live(30)
    assert judge.violations == {}
    return simulation.forger.attempts, sum(bool(sent.writes) for sent in judge.sent.values())


@pytest.mark.timeout(300)
@pytest.mark.parametrize("thief", [False, True], ids=["brokers", "activator"])
def test_nothing_that_an_adversary_says_is_executed(thief: bool) -> None:
    tried, executed = Counter[str](), 0
    for seed in range(SEEDS):
        found, done = attempts(seed, thief)
        tried += found
        executed += done
    assert set(tried) == WAYS | ({"stolen key"} if thief else set())
    assert tried.total() > 400 * SEEDS
    assert executed > SEEDS  # while honest commands go on being flown


def test_without_an_adversary_a_fleet_that_signs_flies() -> None:
    simulation = HostileSimulation(1, replace(CALM, selects=0), rate=0.0)
    judge = simulation.live(20)
    assert judge.violations == {}
    assert judge.unsent < 5  # to a drone that starts anew, until its fog has named its session
    assert sum(bool(sent.writes) for sent in judge.sent.values()) > 60
