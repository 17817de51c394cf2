"""Brokers and an activator that are the adversary's, against a fleet that signs: none executed, late, or doubled.

What they say is drawn from what passes: replayed, moved to other topics and drones, changed, signed with other keys,
delivered seconds later, held back, rolled back as retained, and denied (0x10) though delivered. Every process is
killed and started again meanwhile, so that what is replayed is often of before. Honest commands beside that end in
exactly one last word each.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, field, replace

import pytest

from mqttxt.activator.drones import CLOUD, FOG
from tests.examples import first_quick
from tests.simulation.adversary import CALM, Dangers
from tests.simulation.broken import BROKEN, BROKEN_STATIONS, BrokenSimulation, Found
from tests.simulation.hostile import THIEF, HostileSimulation

DANGERS = Dangers(latencies_us=((0, 1000), (3000, 40_000)), aims=0.05, stalls_per_s=0.003, kills_per_s=0.01, selects=0)
"""Weather in which commands are flown, so that it is the adversary who delays them and brings them twice.

A choice by the fog alone is not for a fleet that signs (R12.16).
"""
WAYS = {
    "replayed",
    "moved",
    "flipped",
    "rerouted",
    "swapped",
    "altered",
    "worded",
    "made_up",
    "will replayed",
    "rolled back",
    "said 0x10",
    "held back",
}


@dataclass
class Tried:
    """What was tried in vain, by where and how; what honest stations' commands came to; who was started again."""

    attempts: Counter[tuple[str, str]] = field(default_factory=Counter)
    sent: int = 0
    executed: int = 0
    restarts: Counter[str] = field(default_factory=Counter)

    def at(self, place: str) -> int:
        return sum(count for (where, _), count in self.attempts.items() if where == place)

    @property
    def ways(self) -> set[str]:
        return {way for _, way in self.attempts}

    def add(self, seed: int, thief: bool) -> None:
        """One history of half a minute, in which nothing may come of any attempt."""
        simulation = HostileSimulation(seed, DANGERS, rate=0.3, thief=thief)
        judge = simulation.live(30)
        assert judge.violations == {}, f"seed {seed}"
        self.attempts += simulation.forger.attempts
        self.sent += len(judge.sent)
        self.executed += sum(bool(sent.writes) for sent in judge.sent.values())
        for node in simulation.nodes:
            self.restarts[node.name] += (node.generation - 1) // 2


@pytest.mark.long
@pytest.mark.parametrize("seed", first_quick(range(2)))
@pytest.mark.parametrize("thief", [False, True], ids=["brokers", "activator"])
def test_nothing_that_an_adversary_says_is_executed(thief: bool, seed: int) -> None:
    tried = Tried()
    tried.add(seed, thief)
    assert tried.ways == WAYS | ({"stolen key"} if thief else set())
    assert tried.attempts.total() > 400
    assert tried.executed > 1  # while honest commands go on being flown


@pytest.mark.long
@pytest.mark.parametrize("variant", [*BROKEN, *BROKEN_STATIONS])
def test_a_role_that_is_broken_is_found(variant: str) -> None:
    """Mostly by the first history; a test of an adversary shows nothing that would not find such a role."""

    def live() -> None:
        for seed, thief in itertools.product(range(4), (False, True)):
            BrokenSimulation(seed, DANGERS, rate=0.3, variant=variant, thief=thief).live(30)

    with pytest.raises(Found):
        live()


@pytest.mark.long
@pytest.mark.soak("services/mqttxt/src/mqttxt", "tests/simulation")
@pytest.mark.timeout(900)
@pytest.mark.parametrize("places", [(CLOUD, FOG), (THIEF,)], ids=["brokers", "activator"])
def test_of_ten_thousand_attempts_at_each_place_nothing_is_executed(places: tuple[str, ...]) -> None:
    tried = Tried()
    seed = 100
    while min(map(tried.at, places)) < 10_000 or min(tried.restarts.values()) < 3:
        tried.add(seed, thief=THIEF in places)
        seed += 1
    assert tried.ways >= WAYS
    assert tried.executed > tried.sent / 20


@pytest.mark.long
def test_without_an_adversary_a_fleet_that_signs_flies() -> None:
    simulation = HostileSimulation(1, replace(CALM, selects=0), rate=0.0)
    judge = simulation.live(20)
    assert judge.violations == {}
    assert judge.unsent == 0
    assert sum(bool(sent.writes) for sent in judge.sent.values()) > 60
