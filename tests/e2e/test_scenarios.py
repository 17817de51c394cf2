"""Scenarios 2 and 4 over both, in their shortest form; what sensors measured arrives whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from testbed.fly.results import Attempt
from tests.e2e.agreement import assert_pymavlink_agrees, assert_tshark_agrees
from tests.e2e.flying import Run, attempt_over, few_drones, quick_drones

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(900)]

COMMANDS = ["arm", "takeoff", "goto", "return"]
SAMPLES = 1
SERIES_A_DRONE = 3


class Flight(NamedTuple):
    """A scenario, the arm that it is flown in, and by how many drones."""

    scenario: str
    arm: str = "five-states-bundled"
    fleet: Callable[[Path], dict[str, str]] = few_drones


READINGS = pytest.mark.soak(
    *("services/router/src", "services/sensor/src", "testbed/plan/sensors.py"),
    *(f"services/mission/src/mission/{name}.py" for name in ("plain_readings", "series")),
)
SCENARIO_2 = pytest.param(Flight("scenario-2"), id="scenario-2")
SCENARIO_4 = pytest.param(Flight("scenario-4"), marks=READINGS, id="scenario-4")
FULL_STREAMS = pytest.param(
    Flight("scenario-4", "thesis", quick_drones),
    marks=[pytest.mark.alone, READINGS],
    id="scenario-4-thesis",
)
"""Readings of the experiments' fleet beside all that PX4 streams; readings without that are in SCENARIO_4, those
streams in scenario 1."""


@pytest.fixture(scope="module")
def flown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    flight: Flight = request.param
    folder: Path = tmp_path_factory.mktemp("flown")
    options = ["--arm", flight.arm, "--samples", str(SAMPLES)]
    run = Run(folder / "results", *options, experiment=flight.scenario, environment=flight.fleet(folder))
    assert run.wait() == 0, run.output
    return run


def drones_of(attempt: Attempt) -> list[int]:
    return [int(node.name.removeprefix("uav")) for node in attempt.topology().nodes if node.name.startswith("uav")]


@pytest.mark.parametrize("flown", [SCENARIO_2, SCENARIO_4, FULL_STREAMS], indirect=True)
def test_every_drone_completes_every_command_of(flown: Run) -> None:
    for protocol in ("mqttxt", "mavlink"):
        (attempt,) = flown.metrics()["protocols"][protocol]["attempts"]
        assert attempt["status"] == "completed"
        assert {*attempt["outcomes"]} == {str(drone) for drone in drones_of(attempt_over(flown, protocol))}
        for drone, said in attempt["outcomes"].items():
            assert [(o["command"], o["word"]) for o in said] == [(c, "completed") for c in COMMANDS], drone
        assert attempt["message_loss"]["commands"] == 0.0


@pytest.mark.parametrize("flown", [SCENARIO_4, FULL_STREAMS], indirect=True)
def test_what_the_sensors_measured_arrives_whole(flown: Run) -> None:
    for protocol in ("mqttxt", "mavlink"):
        (attempt,) = flown.metrics()["protocols"][protocol]["attempts"]
        flight = attempt_over(flown, protocol)
        drones = drones_of(flight)
        series = json.loads((flight.path / "series.json").read_text())["series"]
        assert len(series) == SERIES_A_DRONE * len(drones)
        assert all(one["whole"] and one["delivered"] == SAMPLES for one in series), series
        assert [
            {name: one[name] for name in told} for one, told in zip(attempt["series"], series, strict=True)
        ] == series, "the files alone say the same as the mission"
        assert attempt["reading_delay_ms"]["captures"]["n"] == len(series) * SAMPLES
        changes = [json.loads(line) for line in (flight.path / "links" / "events.jsonl").read_text().splitlines()]
        opened = {change["link"] for change in changes if change.get("cause") == "range" and not change["change"]}
        assert opened == {f"sense:uav{drone}:{way}" for drone in drones for way in ("up", "down")}


@pytest.mark.parametrize("protocol", ["mqttxt", "mavlink"])
@pytest.mark.parametrize("flown", [SCENARIO_2], indirect=True)
def test_other_programs_count_the_same_in_the_captures_of(flown: Run, protocol: str) -> None:
    attempt = attempt_over(flown, protocol)
    assert_tshark_agrees(attempt)
    assert_pymavlink_agrees(attempt)
