"""What follows from a fleet: addresses, links, routers."""

from __future__ import annotations

import pytest

from testbed.plan.fleet import Fleet
from testbed.plan.fleets import fleet_of, standard_fleet

DRONES = range(1, 7)


@pytest.fixture(scope="module")
def large() -> Fleet:
    """Three fogs with four drones each."""
    return fleet_of({"FOGS": "3", "DRONES": "12"})


def test_nodes_have_the_addresses_of_the_design() -> None:
    expected = {"gs": "198.18.0.3", "cloud": "198.18.1.3", "fog1": "198.18.11.3", "fog2": "198.18.12.3"}
    expected |= {f"uav{drone}": f"198.18.2{drone}.3" for drone in DRONES}
    assert {node.name: node.address for node in standard_fleet().topology().nodes} == expected


def test_every_node_of_another_fleet_has_an_address_of_its_own(large: Fleet) -> None:
    nodes = large.nodes(sensors=True)
    assert len(nodes) == 2 + 3 + 12 + 12
    addresses = [*map(large.address, nodes), *map(large.gateway, nodes)]
    assert len(set(addresses)) == len(addresses)
    assert (large.address("fog3"), large.address("uav12"), large.address("sensor12")) == (
        "198.18.13.3",
        "198.18.32.3",
        "198.19.26.131",
    )


def test_links_lead_up_to_the_cloud() -> None:
    found = {link.name: (link.lower, link.upper) for link in standard_fleet().topology().links}
    expected = {"wan:gs": ("gs", "cloud"), "backhaul:fog1": ("fog1", "cloud"), "backhaul:fog2": ("fog2", "cloud")}
    expected |= {f"air:uav{drone}": (f"uav{drone}", "fog1" if drone <= 3 else "fog2") for drone in DRONES}
    assert found == expected


def test_the_links_of_another_fleet_are_named_after_its_nodes(large: Fleet) -> None:
    found = {link.name: (link.lower, link.upper) for link in large.topology(sensors=True).links}
    assert len(found) == 1 + 3 + 12 + 12
    assert found["backhaul:fog3"] == ("fog3", "cloud")
    assert [found[f"air:uav{drone}"][1] for drone in (1, 4, 5, 8, 9, 12)] == ["fog1", "fog1", "fog2", "fog2"] + 2 * [
        "fog3"
    ]
    assert found["sense:uav12"] == ("sensor12", "uav12")


@pytest.mark.parametrize(
    ("source", "destination", "link"),
    [
        ("gs", "cloud", "wan:gs:up"),
        ("cloud", "fog2", "backhaul:fog2:down"),
        ("uav4", "fog2", "air:uav4:up"),
        ("fog1", "uav3", "air:uav3:down"),
        ("uav1", "fog2", None),
        ("gs", "uav1", None),
    ],
)
def test_a_link_is_an_ordered_pair_of_neighbours(source: str, destination: str, link: str | None) -> None:
    assert standard_fleet().topology().link_of(source, destination) == link


def test_an_address_has_a_name() -> None:
    topology = standard_fleet().topology()
    assert (topology.name_of("198.18.24.3"), topology.name_of("198.18.24.2")) == ("uav4", None)


def test_the_routers_of_ten_drones_have_ids_that_are_easy_to_read_and_of_more_ids_that_suffice() -> None:
    assert standard_fleet().routers("fog2", shared=False)[0].endswith("--hb-systemid=224")
    last = fleet_of({"DRONES": "48"})
    assert last.has_routers
    assert last.routers("gs", shared=False)[0].endswith("--hb-systemid=49")
    assert last.routers("uav48", shared=False)[0].endswith("--hb-systemid=240")
    assert not fleet_of({"DRONES": "49"}).has_routers
