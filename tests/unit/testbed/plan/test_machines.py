"""A fleet over several machines: who has which nodes, and each machine's compose file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from testbed.cli import commands as cli
from testbed.errors import UserError
from testbed.plan.compose import compose_text
from testbed.plan.experiments import make_plan, on_machines
from testbed.plan.fleet import Fleet
from testbed.plan.fleets import fleet_of, standard_fleet
from testbed.plan.machines import compose_here, compose_there, machines_of, volumes_of

TWO = {"MACHINES": "ssh://a, unix:///run/b.sock"}


def _loaded(text: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(text)
    return found


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    return fleet_of({"FOGS": "3", "DRONES": "7"})


def test_nothing_is_spread_where_no_machine_is_named(fleet: Fleet) -> None:
    assert machines_of({}, fleet) == machines_of({"MACHINES": " , "}, fleet) == ()
    plan = make_plan("scenario-1")
    assert on_machines(plan, {}) is plan


def test_a_machine_may_have_any_name_that_ssh_config_gives_it(fleet: Fleet) -> None:
    (machine,) = machines_of({"MACHINES": "ssh://the_ops@lab_2.rack-1:2222"}, fleet)
    assert machine.name == "the_ops@lab_2.rack-1:2222"


def test_each_fog_goes_with_its_drones_to_the_machine_that_has_the_fewest(fleet: Fleet) -> None:
    first, second = machines_of(TWO, fleet)
    assert (first.name, second.name) == ("a", "/run/b.sock")
    assert fleet.fogs == {1: (1, 2, 3), 2: (4, 5), 3: (6, 7)}
    assert first.nodes == ("fog1", "uav1", "uav2", "uav3")
    assert second.nodes == ("fog2", "fog3", "uav4", "uav5", "uav6", "uav7")


@pytest.mark.long
def test_every_service_is_on_one_machine_and_net_on_this_one(fleet: Fleet) -> None:
    machines = machines_of(TWO, fleet)
    here, *there = [
        _loaded(text) for text in (compose_here(fleet, machines), *(compose_there(fleet, m) for m in machines))
    ]
    placed = [name for document in (here, *there) for name in document["services"]]
    assert sorted(placed) == sorted(_loaded(compose_text(fleet))["services"])
    assert {"net", "gs", "cloud", "broker", "router-gs", "router-cloud"} <= set(here["services"])
    for machine, document in zip(machines, there, strict=True):
        own = {name for name in document["services"] if name.startswith(("fog", "uav"))}
        assert own == set(machine.nodes)
        drones = [node.removeprefix("uav") for node in machine.nodes if node.startswith("uav")]
        assert {f"{kind}{drone}" for kind in ("sitl", "client", "router-uav") for drone in drones} <= set(
            document["services"]
        )


def test_nodes_on_other_machines_are_at_overlays_with_their_own_addresses(fleet: Fleet) -> None:
    machines = machines_of(TWO, fleet)
    here = _loaded(compose_here(fleet, machines))
    for machine in machines:
        there = _loaded(compose_there(fleet, machine))
        for node in machine.nodes:
            overlay = {"external": True, "name": f"mqttxt-testbed-{node}"}
            assert there["networks"][node] == here["networks"][node] == overlay
            assert there["services"][node]["networks"] == {node: {"ipv4_address": fleet.address(node)}}
            assert here["services"]["net"]["networks"][node] == {"ipv4_address": fleet.gateway(node)}
        assert set(there["networks"]) == set(machine.nodes)
    assert here["networks"]["gs"] == {"ipam": {"config": [{"subnet": str(fleet.network("gs"))}]}}


def test_another_machine_has_no_net_to_wait_for_and_its_volumes_are_there_before(fleet: Fleet) -> None:
    machines = machines_of(TWO, fleet)
    there = _loaded(compose_there(fleet, machines[0]))
    assert not [name for name, service in there["services"].items() if "depends_on" in service]
    assert set(there["volumes"]) == set(volumes_of(fleet)) == {"live", "fleet", "routers"}
    assert all(volume["external"] for volume in there["volumes"].values())
    assert volumes_of(fleet)["live"] == {}
    assert volumes_of(fleet)["routers"]["type"] == "tmpfs"


@pytest.mark.parametrize(
    ("machines", "said"),
    [
        ("a", "MACHINES: a: expected ssh://[USER@]HOST[:PORT] or unix:///PATH, a list with commas"),
        ("ssh://-oProxyCommand=x", "MACHINES: ssh://-oProxyCommand=x: expected ssh://"),
        ("tcp://a:2375", "MACHINES: tcp://a:2375: expected ssh://"),
        ("ssh://a:0", "MACHINES: ssh://a:0: expected ssh://"),
        ("ssh://a:65536", "MACHINES: ssh://a:65536: expected ssh://"),
        ("ssh://[::1]", "MACHINES: ssh://[::1]: expected ssh://"),
        ("ssh://ops:secret@a", "MACHINES: ssh://ops:***@a: expected ssh://"),
        ("ssh://ops:s@cr:et@a:22", "MACHINES: ssh://ops:***@a:22: expected ssh://"),
        ("ssh://a,ssh://a", "MACHINES: ssh://a: expected each machine once"),
        ("ssh://a,ssh://b,ssh://c", "MACHINES: 3 machines: expected no more than there are fogs, 2 (FOGS)"),
    ],
)
def test_a_wrong_machine_is_one_line(machines: str, said: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(UserError) as error:
        machines_of({"MACHINES": machines}, standard_fleet())
    assert str(error.value).startswith(said)
    monkeypatch.setenv("MACHINES", machines)
    result = CliRunner().invoke(cli.app, ["run", "scenario-1", "--results", str(tmp_path)])
    assert result.exit_code == 2
    assert result.output.startswith(f"testbed: {said}")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("experiment", "factors", "environment", "said"),
    [
        ("scenario-4", {}, {}, "scenario-4: "),
        ("messages", {}, {}, "messages: "),
        ("scenario-1", {"security": "tls"}, {}, "SECURITY=tls: "),
        ("scenario-1", {}, {"AUTOPILOT": "px4"}, "AUTOPILOT=px4: "),
        ("scenario-1", {}, {"ROUTER": "official"}, "ROUTER=official: "),
    ],
)
def test_what_needs_one_machine_is_refused(
    experiment: str, factors: dict[str, str], environment: dict[str, str], said: str
) -> None:
    plan = make_plan(experiment, overrides=factors)
    with pytest.raises(UserError) as error:
        on_machines(plan, environment | TWO)
    assert str(error.value).startswith(said)
    assert str(error.value).endswith(" with MACHINES")


@pytest.mark.parametrize("command", [["up"], ["links"], ["all"], ["reproduce"], ["worker", "--scheduler", "tls://a:1"]])
def test_other_commands_use_one_machine(command: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MACHINES", "ssh://a")
    result = CliRunner().invoke(cli.app, command)
    assert result.exit_code == 2
    assert result.output.startswith("testbed: MACHINES=ssh://a: expected none for ")


def test_results_say_on_how_many_machines_they_were_flown() -> None:
    plan = on_machines(make_plan("scenario-1"), TWO)
    assert plan.label == "thesis+machines-3"
