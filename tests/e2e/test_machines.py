"""A fleet over three machines, which are three Docker daemons here: flown, ended, and one of them lost in flight."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from testbed.fly.results import open_series
from tests.e2e.flying import Run, attempt_over, few_drones
from tests.rigs.machines import DockerMachine, Machines

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.alone,
    pytest.mark.timeout(900),
    pytest.mark.soak(
        "testbed/fly/machines",
        "testbed/fly/calibration/clocks.py",
        "testbed/fly/containers.py",
        "testbed/plan/machines.py",
        "testbed/plan/compose.yaml.jinja",
        "tests/rigs/machines.py",
        too_long=True,
    ),
]
UP_S = 400.0
"""On a busy machine images, overlays and containers of three daemons take minutes."""
OWN_NETWORKS = {"bridge", "host", "none"}


@pytest.fixture(scope="module")
def machines() -> Iterator[Machines]:
    found = Machines(3)
    try:
        yield found.start()
    finally:
        found.close()


def _left(machine: DockerMachine) -> dict[str, Any]:
    """What a machine has that it did not have before."""
    with contextlib.closing(machine.client()) as client:
        return {
            "containers": [one.name for one in client.containers.list(all=True)],
            "networks": {one.name for one in client.networks.list()} - OWN_NETWORKS,
            "volumes": [one.name for one in client.volumes.list()],
            "swarm": client.info()["Swarm"]["LocalNodeState"],
        }


NOTHING = {"containers": [], "networks": set(), "volumes": [], "swarm": "inactive"}


@pytest.fixture(scope="module")
def flown(machines: Machines, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """One run over both protocols."""
    folder = tmp_path_factory.mktemp("flown")
    run = Run(folder / "results", environment=few_drones(folder) | machines.environment)
    assert run.wait() == 0, run.output
    return run


@pytest.mark.parametrize("protocol", ["mqttxt", "mavlink"])
def test_scenario_1_is_flown_over(flown: Run, machines: Machines, protocol: str) -> None:
    (attempt,) = flown.metrics()["protocols"][protocol]["attempts"]
    assert attempt["status"] == "completed"
    said = {drone: [outcome["word"] for outcome in found] for drone, found in attempt["outcomes"].items()}
    assert said == {str(drone): ["completed"] * 3 for drone in (1, 2, 3)}
    assert all(link["packets"] > 0 and link["lost"] == 0 for link in attempt["links"].values())
    if protocol == "mqttxt":  # MAVSDK says a command again whose answer is late
        assert attempt["receipts"] == {"calls": 9, "doubled": 0, "late": 0}
    assert attempt["delay_ms"]["arm"]
    assert attempt["delay_received_ms"] == {}, "it would need two machines' clocks"
    (note,) = [note for note in attempt["notes"] if note.startswith("past all links the way from net and back took ")]

    flight = attempt_over(flown, protocol)
    ways = flight.manifest()["machines"]
    assert [way["nodes"] for way in ways] == [["gs"], ["fog1", "uav1", "uav2"], ["fog2", "uav3"]]
    assert all(f"{way['round_trip_ms']:.2f} ms to {way['machine']}" in note for way in ways)
    assert set(flight.autopilot_events()) == {"uav1", "uav2", "uav3"}, "they were fetched"
    assert (flight.path / "logs" / "sitl3.log").exists()


def test_nothing_is_left_on_any_machine(flown: Run, machines: Machines) -> None:
    assert [_left(machine) for machine in machines.all] == [NOTHING] * 3


def test_ctrl_c_in_flight_leaves_nothing(machines: Machines, tmp_path: Path) -> None:
    run = Run(tmp_path / "results", "--protocols", "mqttxt", environment=few_drones(tmp_path) | machines.environment)
    run.wait_for(lambda: any("  arm " in line for line in run.lines), UP_S)
    run.interrupt()
    assert run.wait() == 130
    assert [_left(machine) for machine in machines.all] == [NOTHING] * 3
    (series,) = run.results.glob("scenario-1/*-ideal/*")
    (attempt,) = open_series(series).attempts()
    assert attempt.captures() != []


def test_a_machine_that_is_no_machine_is_one_line(machines: Machines, tmp_path: Path) -> None:
    for address, said in {
        f"unix://{tmp_path}/none.sock": "Docker does not answer",
        machines.here.address: "its Docker is that of this machine: expected each machine once",
    }.items():
        environment = machines.environment | {"MACHINES": address}
        run = Run(tmp_path / "results", environment=few_drones(tmp_path) | environment)
        assert run.wait() == 2
        assert run.lines[-1].startswith(f"testbed: MACHINES: {address}: {said}"), run.output
        assert not (tmp_path / "results").exists()


def test_every_command_has_its_last_word_though_a_machine_is_lost(machines: Machines, tmp_path: Path) -> None:
    """The last test of the file: the machine stays lost."""
    lost = machines.others[-1]
    run = Run(tmp_path / "results", "--protocols", "mqttxt", environment=few_drones(tmp_path) | machines.environment)
    run.wait_for(lambda: any("  takeoff " in line for line in run.lines), UP_S)
    lost.kill()
    assert run.wait() == 1
    (attempt,) = open_series(run.latest).attempts()
    reason = attempt.manifest()["reason"]
    assert reason.startswith(f"{lost.name} was lost in flight: "), reason
    events = attempt.events()
    asked = {event["call"]: event["fog"] for event in events if event["event"] == "command"}
    ended = [(one["call"], one["drone"]) for one in events if one["event"] == "outcome" and one["final"]]
    of_fog_1 = [(call, drone) for call, fog in asked.items() if fog == 1 for drone in (1, 2)]
    arm, takeoff, land = (call for call, fog in asked.items() if fog == 2)
    assert sorted(ended, key=str) == sorted([*of_fog_1, (arm, 3), (takeoff, 3), (land, None)], key=str)
    assert "land: drone 3: unconfirmed (no_roster)" in reason, "nobody is left to say which drones the lost fog has"
    assert f"{lost.name}: does not answer; type there: docker swarm leave --force" in run.lines[-1]
    others = [machine for machine in machines.all if machine is not lost]
    assert [_left(machine) for machine in others] == [NOTHING] * 2
