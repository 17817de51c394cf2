"""How a load of many drones is divided among fleets, before any of it runs."""

from __future__ import annotations

from tests.bench.load import Fogs


def test_drones_beyond_the_ids_of_a_fleet_are_several_fleets() -> None:
    plan = Fogs(10, 100).plan()
    assert [fog for _, fog, _, _ in plan] == list(range(1, 11))
    assert [(prefix, first, last) for prefix, _, first, last in plan[:3]] == [
        ("fleet1/", 1, 100),
        ("fleet1/", 101, 200),
        ("fleet2/", 1, 100),
    ]
    assert plan[-1][0] == "fleet5/"


def test_few_drones_are_as_many_fleets_as_asked_for() -> None:
    fleets = [prefix for prefix, *_ in Fogs(10, 8, fleets=4).plan()]
    assert sorted(set(fleets)) == ["fleet1/", "fleet2/", "fleet3/", "fleet4/"]
    assert max(map(fleets.count, fleets)) == 3
