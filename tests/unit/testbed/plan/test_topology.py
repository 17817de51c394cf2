"""The order of links and nodes in a list."""

from __future__ import annotations

from itertools import pairwise

from testbed.plan.topology import by_number, place_of_link


def test_links_are_listed_from_the_ground_station_outwards_by_their_numbers() -> None:
    ordered = ["wan:gs:up", "wan:gs:down", "backhaul:fog2", "backhaul:fog10", "air:uav2:up", "air:uav2:down"]
    ordered += ["air:uav10:up", "air:uav10:down", "air:uav21:up", "sense:uav3:up", "sense:uav12:up", "other"]
    assert all(place_of_link(one) < place_of_link(next_one) for one, next_one in pairwise(ordered))


def test_nodes_are_listed_by_their_numbers() -> None:
    assert sorted(["uav10", "uav2", "cloud", "uav1"], key=by_number) == ["cloud", "uav1", "uav2", "uav10"]
