"""A fleet's compose file agrees with itself and with the fleet; the checked-in files are services/fleet.yaml's."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from testbed.errors import UserError
from testbed.fly.containers import services_of
from testbed.plan.compose import COMPOSE_FILE, compose_text, laid_over, read_services
from testbed.plan.experiments import PROTOCOLS
from testbed.plan.fleet import Fleet
from testbed.plan.fleets import fleet_of
from testbed.plan.overrides import OVERRIDES, files_of_standard_fleet
from testbed.plan.sensors import sensor_settings

FLEETS = {
    "2x3": {},
    "1x2": {"FOGS": "1", "DRONES": "2"},
    "3x4": {"FOGS": "3", "DRONES": "12"},
    "5x48": {"FOGS": "5", "DRONES": "48"},
}


@pytest.fixture(scope="module", params=FLEETS)
def fleet(request: pytest.FixtureRequest) -> Fleet:
    return fleet_of(FLEETS[request.param])


@pytest.fixture(scope="module")
def services(fleet: Fleet) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(compose_text(fleet))["services"]
    return found


def test_the_checked_in_files_are_those_of_the_experiments_fleet() -> None:
    """After a change: python -m testbed fleet."""
    made = files_of_standard_fleet()
    assert {path: path.read_text() for path in made} == made
    assert COMPOSE_FILE in made


def _variables(fleet: Fleet, text: str, sensors: bool) -> list[str]:
    """A list of net's with its variable filled in, as without sensors or as with them."""
    for name, value in sensor_settings(fleet, "mqttxt", 30).items():
        text = text.replace(f"${{{name}:-}}", value if sensors else "")
    return text.split()


@pytest.mark.parametrize("sensors", [False, True])
def test_net_is_the_gateway_of_every_node(fleet: Fleet, services: dict[str, Any], sensors: bool) -> None:
    topology = fleet.topology(sensors=sensors)
    listed = dict(item.split("=") for item in _variables(fleet, services["net"]["environment"]["NODES"], sensors))
    gateways = {node.name: services[node.name]["environment"]["GATEWAY"] for node in topology.nodes}
    assert listed == {node.name: f"{gateways[node.name]},{node.address}" for node in topology.nodes}
    attached = {name: config["ipv4_address"] for name, config in services["net"]["networks"].items()}
    assert gateways.items() <= attached.items()
    own = {node.name: services[node.name]["networks"][node.name]["ipv4_address"] for node in topology.nodes}
    assert own == {node.name: node.address for node in topology.nodes}


@pytest.mark.parametrize("sensors", [False, True])
def test_net_routes_along_the_links(fleet: Fleet, services: dict[str, Any], sensors: bool) -> None:
    listed = [tuple(item.split("-")) for item in _variables(fleet, services["net"]["environment"]["LINKS"], sensors)]
    links = fleet.topology(sensors=sensors).links
    assert {frozenset(pair) for pair in listed} == {frozenset((link.lower, link.upper)) for link in links}
    assert len(listed) == len(links)


def test_each_drone_has_a_sensor_below_it(fleet: Fleet, services: dict[str, Any]) -> None:
    for drone in fleet.fog_of:
        meter = services[f"meter{drone}"]
        assert meter["network_mode"] == f"service:sensor{drone}"
        broker = f"${{MQTT:-mqtt}}://{fleet.address(f'uav{drone}')}:${{MQTT_PORT:-1883}}"
        assert f"sensor --broker {broker} --number {drone} " in meter["command"]
        assert f" ${{SENSOR{drone}_AS:---insecure}} " in meter["command"]
        assert f"--events /run-dir/sensors/sensor{drone}.jsonl" in meter["command"]


def test_plain_brokers_lead_from_each_uav_over_its_fog_to_the_cloud(fleet: Fleet, services: dict[str, Any]) -> None:
    for link in fleet.topology().links:
        if not link.name.startswith("wan:"):
            bridge = services[f"bridge-{link.lower}"]
            assert bridge["network_mode"] == f"service:{link.lower}"
            assert bridge["command"][1:] == [link.lower.replace("uav", "drone"), fleet.address(link.upper)]
    assert services["bridge-cloud"]["network_mode"] == "service:cloud"


def test_each_drone_talks_to_its_own_fog_and_its_own_autopilot(fleet: Fleet, services: dict[str, Any]) -> None:
    for drone, fog in fleet.fog_of.items():
        client, autopilot = services[f"client{drone}"], services[f"sitl{drone}"]
        to_fog = f"--broker ${{AIR_SCHEME:-mqtt}}://{fleet.address(f'fog{fog}')}:${{AIR_PORT:-1883}}"
        assert f" ${{UAV{drone}_AS:---insecure}} " in client["command"]
        assert f"--drone {drone} {to_fog} --autopilot udp:127.0.0.1:{14540 + drone}" in client["command"]
        assert f"--endurance-s {fleet.drones[drone]['endurance_s']} " in client["command"]
        assert f"--system {drone} " in autopilot["command"]
        assert f":{14580 + drone} --send ${{AUTOPILOT_TO:-127.0.0.1}}:{14540 + drone}" in autopilot["command"]
        assert client["network_mode"] == autopilot["network_mode"] == f"service:uav{drone}"


def test_each_activator_has_the_drones_of_its_fog(fleet: Fleet, services: dict[str, Any]) -> None:
    for fog, drones in fleet.fogs.items():
        said = re.findall(r"--(fog|drones|cloud) (\S+)", services[f"activator{fog}"]["command"])
        listed = ",".join(str(drone) for drone in drones)
        cloud = f"${{MQTT:-mqtt}}://{fleet.address('cloud')}:${{MQTT_PORT:-1883}}"
        assert said == [("fog", str(fog)), ("drones", listed), ("cloud", cloud)]
        assert f" ${{FOG{fog}_AS:---insecure}} " in services[f"activator{fog}"]["command"]


def test_both_protocols_have_the_same_nodes_and_nothing_else_in_common(fleet: Fleet, services: dict[str, Any]) -> None:
    profiles = {name: {*PROTOCOLS} & set(service["profiles"]) for name, service in services.items()}
    both = {name for name, found in profiles.items() if found == {*PROTOCOLS}}
    assert both == {"net", *fleet.nodes(), *(f"sitl{drone}" for drone in fleet.fog_of)}
    roles = {name: str(services[name]["command"]) for name in services if profiles[name] == {"mavlink"}}
    assert sorted(roles) == sorted(f"router-{node}" for node in fleet.nodes())
    assert all(command.startswith("router ") for command in roles.values())


@pytest.mark.parametrize(
    ("protocol", "roles"),
    [
        ("mqttxt", ["broker", "activator1", "client1"]),
        ("mavlink", ["router-gs", "router-cloud", "router-fog1", "router-uav1"]),
    ],
)
def test_the_message_set_has_every_node_and_what_runs_for_uav1(
    tmp_path: Path, fleet: Fleet, protocol: str, roles: list[str]
) -> None:
    path = tmp_path / "compose.yaml"
    path.write_text(compose_text(fleet))
    assert services_of((f"{protocol}-one",), path) == ["net", *fleet.nodes(), "sitl1", *roles]
    assert set(services_of((f"{protocol}-one",), path)) < set(services_of((protocol,), path))


@pytest.mark.parametrize("chain", ["PER_UAV", "SHARED"])
def test_every_router_sends_to_one_that_listens_and_has_a_system_id_of_its_own(
    fleet: Fleet, services: dict[str, Any], chain: str
) -> None:
    listens, sends, ids = [], [], []
    for node in fleet.nodes():
        for line in services[f"router-{node}"]["environment"][chain].splitlines():
            server, client, system = line.split()
            listens.append((node if "127.0.0.1" in server else "", server.removeprefix("udps:")))
            sends.append(client.removeprefix("udpc:"))
            ids.append(int(system.removeprefix("--hb-systemid=")))
    assert len(set(listens)) == len(listens), "no two chains meet at a port"
    own = {f"127.0.0.1:{14540 + drone}" for drone in fleet.fog_of}
    to_station = own if chain == "PER_UAV" else {"127.0.0.1:14540"}
    assert set(sends) - to_station == {server for node, server in listens if not node}
    assert {server for node, server in listens if node} == own, "of the autopilots, each in its own node"
    assert len(ids) == len(set(ids)) == (4 * len(fleet.fog_of) if chain == "PER_UAV" else len(fleet.nodes()))
    assert not set(ids) & {*fleet.fog_of, 245, 255}
    assert max(ids) < 245


def test_a_nodes_routers_start_after_those_that_they_send_to(fleet: Fleet, services: dict[str, Any]) -> None:
    above = {link.lower: link.upper for link in fleet.topology().links} | {"cloud": "gs"}
    for node in fleet.nodes():
        said = re.findall(r"--(after|listening) /run/routers/(\w+)", services[f"router-{node}"]["command"])
        assert said == [*([] if node == "gs" else [("after", above[node])]), ("listening", node)]


def test_nothing_is_privileged_or_throttled(services: dict[str, Any]) -> None:
    for name, service in services.items():
        assert service["cap_drop"] == ["ALL"], name
        assert service["read_only"], name
        assert "mem_limit" in service, name
        assert "cpu_shares" in service, name
        assert not {"privileged", "cpus", "cpu_quota", "ports"} & service.keys(), name


@pytest.mark.parametrize("profile", ["mqttxt", "mavlink", "mqttxt-one", "mavlink-one", "sensors", "mavlink-sensors"])
def test_what_a_profile_joins_is_in_it(services: dict[str, Any], profile: str) -> None:
    chosen = {name: one for name, one in services.items() if profile in one["profiles"]}
    joined = {one["network_mode"].removeprefix("service:") for one in chosen.values() if "network_mode" in one}
    assert joined <= set(chosen)


@pytest.mark.long
def test_every_network_that_is_joined_is_there_once(fleet: Fleet) -> None:
    document = yaml.safe_load(compose_text(fleet))
    joined = {name for service in document["services"].values() for name in service.get("networks", {})}
    subnets = [network["ipam"]["config"][0]["subnet"] for network in document["networks"].values()]
    assert joined == set(document["networks"]) == set(fleet.nodes(sensors=True))
    assert len(subnets) == len(set(subnets))


@pytest.mark.long
def test_more_drones_than_mavlink_has_ids_for_have_no_routers() -> None:
    services = yaml.safe_load(compose_text(fleet_of({"DRONES": "49"})))["services"]
    assert "client49" in services
    assert not [name for name in services if name.startswith("router-")]


@pytest.mark.parametrize("path", [path for by_name in OVERRIDES.values() for path in by_name.values()], ids=str)
def test_what_is_laid_over_changes_the_same_of_each_drone_of_another_fleet(fleet: Fleet, path: Path) -> None:
    change = next(iter(read_services(path).values()))
    changed = yaml.safe_load(laid_over(path.read_text(), fleet))["services"]
    drones = [f"sitl{drone}" for drone in fleet.fog_of]
    assert list(changed) == (drones if "sitl" in str(path) else [f"router-{node}" for node in fleet.nodes()])
    assert all(one == change for one in changed.values())


@pytest.mark.parametrize("text", ["", "[", "networks: {}"])
def test_a_malformed_file_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "compose.yaml"
    path.write_text(text)
    with pytest.raises(UserError) as error:
        read_services(path)
    assert str(error.value).startswith(f"{path}: expected a compose file with services: ")
