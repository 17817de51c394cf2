"""The topology that compose.yaml describes, and compose.yaml's agreement with itself."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from testbed.errors import UserError
from testbed.fly.containers import services_of
from testbed.plan.experiments import PROTOCOLS
from testbed.plan.sensors import sensor_settings
from testbed.plan.topology import COMPOSE_FILE, read_services, read_topology

DRONES = range(1, 7)


@pytest.fixture(scope="module")
def services() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(COMPOSE_FILE.read_text())["services"]
    return found


def test_nodes_have_the_addresses_of_the_design() -> None:
    expected = {"gs": "198.18.0.3", "cloud": "198.18.1.3", "fog1": "198.18.11.3", "fog2": "198.18.12.3"}
    expected |= {f"uav{drone}": f"198.18.2{drone}.3" for drone in DRONES}
    assert {node.name: node.address for node in read_topology().nodes} == expected


def test_links_lead_up_to_the_cloud() -> None:
    found = {link.name: (link.lower, link.upper) for link in read_topology().links}
    expected = {"wan:gs": ("gs", "cloud"), "backhaul:fog1": ("fog1", "cloud"), "backhaul:fog2": ("fog2", "cloud")}
    expected |= {f"air:uav{drone}": (f"uav{drone}", "fog1" if drone <= 3 else "fog2") for drone in DRONES}
    assert found == expected


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
    assert read_topology().link_of(source, destination) == link


def test_an_address_has_a_name() -> None:
    assert read_topology().name_of("198.18.24.3") == "uav4"
    assert read_topology().name_of("198.18.24.2") is None


def _variables(text: str, sensors: bool) -> list[str]:
    """A list of net's with its variable filled in, as without sensors or as with them."""
    for name, value in sensor_settings("mqttxt", 30).items():
        text = text.replace(f"${{{name}:-}}", value if sensors else "")
    return text.split()


@pytest.mark.parametrize("sensors", [False, True])
def test_net_is_the_gateway_of_every_node(services: dict[str, Any], sensors: bool) -> None:
    topology = read_topology(sensors=sensors)
    listed = dict(item.split("=") for item in _variables(services["net"]["environment"]["NODES"], sensors))
    gateways = {node.name: services[node.name]["environment"]["GATEWAY"] for node in topology.nodes}
    assert listed == {node.name: f"{gateways[node.name]},{node.address}" for node in topology.nodes}
    attached = {name: config["ipv4_address"] for name, config in services["net"]["networks"].items()}
    assert gateways.items() <= attached.items()


@pytest.mark.parametrize("sensors", [False, True])
def test_net_routes_along_the_links(services: dict[str, Any], sensors: bool) -> None:
    listed = [tuple(item.split("-")) for item in _variables(services["net"]["environment"]["LINKS"], sensors)]
    links = read_topology(sensors=sensors).links
    assert {frozenset(pair) for pair in listed} == {frozenset((link.lower, link.upper)) for link in links}
    assert len(listed) == len(links)


def test_each_drone_has_a_sensor_below_it(services: dict[str, Any]) -> None:
    topology = read_topology(sensors=True)
    address = {node.name: node.address for node in topology.nodes}
    for drone in DRONES:
        assert topology.link_of(f"sensor{drone}", f"uav{drone}") == f"sense:uav{drone}:up"
        meter = services[f"meter{drone}"]
        assert meter["network_mode"] == f"service:sensor{drone}"
        assert f"sensor --broker mqtt://{address[f'uav{drone}']}:1883 --number {drone} " in meter["command"]
        assert f"--events /run-dir/sensors/sensor{drone}.jsonl" in meter["command"]


def test_plain_brokers_lead_from_each_uav_over_its_fog_to_the_cloud(services: dict[str, Any]) -> None:
    topology = read_topology()
    address = {node.name: node.address for node in topology.nodes}
    for link in topology.links:
        if not link.name.startswith("wan:"):
            bridge = services[f"bridge-{link.lower}"]
            assert bridge["network_mode"] == f"service:{link.lower}"
            name, host = bridge["command"][1:]
            assert host == address[link.upper]
            assert name == link.lower.replace("uav", "drone")
    assert services["bridge-cloud"]["network_mode"] == "service:cloud"


def test_each_drone_talks_to_its_own_fog_and_its_own_autopilot(services: dict[str, Any]) -> None:
    topology = read_topology()
    address = {node.name: node.address for node in topology.nodes}
    fog = {link.lower: link.upper for link in topology.links if link.name.startswith("air:")}
    for drone in DRONES:
        client, autopilot = services[f"client{drone}"], services[f"sitl{drone}"]
        to_fog = f"--broker mqtt://{address[fog[f'uav{drone}']]}:1883"
        assert f"--drone {drone} {to_fog} --autopilot udp:127.0.0.1:1454{drone}" in client["command"]
        assert f"--system {drone} " in autopilot["command"]
        assert f":1458{drone} --send ${{AUTOPILOT_TO:-127.0.0.1}}:1454{drone}" in autopilot["command"]
        assert client["network_mode"] == autopilot["network_mode"] == f"service:uav{drone}"


def test_both_protocols_have_the_same_nodes_and_nothing_else_in_common(services: dict[str, Any]) -> None:
    profiles = {name: {*PROTOCOLS} & set(service["profiles"]) for name, service in services.items()}
    both = {name for name, found in profiles.items() if found == {*PROTOCOLS}}
    assert both == {"net", *(node.name for node in read_topology().nodes), *(f"sitl{drone}" for drone in DRONES)}
    roles = {name: str(services[name]["command"]) for name in services if profiles[name] == {"mavlink"}}
    assert sorted(roles) == sorted(f"router-{node.name}" for node in read_topology().nodes)
    assert all(command.startswith("router ") for command in roles.values())


@pytest.mark.parametrize(
    ("protocol", "roles"),
    [
        ("mqttxt", ["broker", "activator1", "client1"]),
        ("mavlink", ["router-gs", "router-cloud", "router-fog1", "router-uav1"]),
    ],
)
def test_the_message_set_has_every_node_and_what_runs_for_uav1(protocol: str, roles: list[str]) -> None:
    nodes = ["net", *(node.name for node in read_topology().nodes)]
    assert services_of((f"{protocol}-one",)) == [*nodes, "sitl1", *roles]
    assert set(services_of((f"{protocol}-one",))) < set(services_of((protocol,)))


@pytest.mark.parametrize("chain", ["PER_UAV", "SHARED"])
def test_every_router_sends_to_one_that_listens_and_has_a_system_id_of_its_own(
    services: dict[str, Any], chain: str
) -> None:
    listens, sends, ids = set(), set(), []
    for node in read_topology().nodes:
        for line in services[f"router-{node.name}"]["environment"][chain].splitlines():
            server, client, system = line.split()
            listens.add(server.removeprefix("udps:"))
            sends.add(client.removeprefix("udpc:"))
            ids.append(int(system.removeprefix("--hb-systemid=")))
    to_station = {f"127.0.0.1:1454{drone}" for drone in DRONES} if chain == "PER_UAV" else {"127.0.0.1:14540"}
    from_autopilots = {f"127.0.0.1:1454{drone}" for drone in DRONES}
    assert sends - to_station == listens - from_autopilots
    assert len(ids) == len(set(ids)) == (24 if chain == "PER_UAV" else 10)
    assert not set(ids) & {*DRONES, 245, 255}


def test_a_nodes_routers_start_after_those_that_they_send_to(services: dict[str, Any]) -> None:
    above = {link.lower: link.upper for link in read_topology().links} | {"cloud": "gs"}
    for node in (node.name for node in read_topology().nodes):
        said = re.findall(r"--(after|listening) /run/routers/(\w+)", services[f"router-{node}"]["command"])
        assert said == [*([] if node == "gs" else [("after", above[node])]), ("listening", node)]


def test_nothing_is_privileged_or_throttled(services: dict[str, Any]) -> None:
    for name, service in services.items():
        assert service["cap_drop"] == ["ALL"], name
        assert service["read_only"], name
        assert "mem_limit" in service, name
        assert "cpu_shares" in service, name
        assert not {"privileged", "cpus", "cpu_quota", "ports"} & service.keys(), name


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected a compose file with services"),
        ("services: {gs: {networks: {a: {}, b: {}}}}", "services.gs.networks: expected one network"),
        ("[", "expected a compose file with services"),
    ],
)
def test_a_malformed_file_is_named(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "compose.yaml"
    path.write_text(text)
    with pytest.raises(UserError) as error:
        read_topology(path)
    assert str(path) in str(error.value)
    assert said in str(error.value)


@pytest.mark.parametrize("profile", ["mqttxt", "mavlink", "mqttxt-one", "mavlink-one", "sensors", "mavlink-sensors"])
def test_what_a_profile_joins_is_in_it(profile: str) -> None:
    services = {name: one for name, one in read_services().items() if profile in one["profiles"]}
    joined = {one["network_mode"].removeprefix("service:") for one in services.values() if "network_mode" in one}
    assert joined <= set(services)
