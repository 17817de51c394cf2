"""Scenarios 2 and 4 over both, in their shortest form; what sensors measured arrives whole."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.e2e.agreement import assert_pymavlink_agrees, assert_tshark_agrees
from tests.e2e.flying import Run, attempt_over, quick_drones

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(900)]

COMMANDS = ["arm", "takeoff", "goto", "return"]
SAMPLES = 1
SERIES = 18


class Flight(NamedTuple):
    """A scenario, and the arm that it is flown in."""

    scenario: str
    arm: str = "five-states-bundled"

    def __str__(self) -> str:
        return "-".join(self)


SCENARIO_2, SCENARIO_4 = Flight("scenario-2"), Flight("scenario-4")
SHAPED = pytest.param(SCENARIO_4, marks=pytest.mark.alone, id="scenario-4")
"""Its sensors' links are shaped, and a shaper needs its time."""
FULL_STREAMS = pytest.param(
    Flight("scenario-4", "thesis"),
    marks=[
        pytest.mark.alone,
        pytest.mark.soak(
            *("services/router/src", "services/sensor/src", "testbed/plan/sensors.py"),
            *(f"services/mission/src/mission/{name}.py" for name in ("plain_readings", "series")),
        ),
    ],
    id="scenario-4-thesis",
)
"""Readings beside all that PX4 streams; readings without that are in SCENARIO_4, those streams in scenario 1."""


@pytest.fixture(scope="module")
def flown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    flight: Flight = request.param
    folder: Path = tmp_path_factory.mktemp("flown")
    options = ["--arm", flight.arm, "--samples", str(SAMPLES)]
    run = Run(folder / "results", *options, experiment=flight.scenario, environment=quick_drones(folder))
    assert run.wait() == 0, run.output
    return run


@pytest.mark.parametrize("flown", [pytest.param(SCENARIO_2, id="scenario-2"), SHAPED, FULL_STREAMS], indirect=True)
def test_every_drone_completes_every_command_of(flown: Run) -> None:
    for protocol in ("mqttxt", "mavlink"):
        (attempt,) = flown.metrics()["protocols"][protocol]["attempts"]
        assert attempt["status"] == "completed"
        for drone, said in attempt["outcomes"].items():
            assert [(o["command"], o["word"]) for o in said] == [(c, "completed") for c in COMMANDS], drone
        assert attempt["message_loss"]["commands"] == 0.0


@pytest.mark.parametrize("flown", [SHAPED, FULL_STREAMS], indirect=True)
def test_what_the_sensors_measured_arrives_whole(flown: Run) -> None:
    for protocol in ("mqttxt", "mavlink"):
        (attempt,) = flown.metrics()["protocols"][protocol]["attempts"]
        flight = attempt_over(flown, protocol)
        series = json.loads((flight.path / "series.json").read_text())["series"]
        assert len(series) == SERIES
        assert all(one["whole"] and one["delivered"] == SAMPLES for one in series), series
        assert [
            {name: one[name] for name in told} for one, told in zip(attempt["series"], series, strict=True)
        ] == series, "the files alone say the same as the mission"
        assert attempt["reading_delay_ms"]["captures"]["n"] == SERIES * SAMPLES
        changes = [json.loads(line) for line in (flight.path / "links" / "events.jsonl").read_text().splitlines()]
        opened = {change["link"] for change in changes if change.get("cause") == "range" and not change["change"]}
        assert opened == {f"sense:uav{drone}:{way}" for drone in range(1, 7) for way in ("up", "down")}


@pytest.mark.parametrize("protocol", ["mqttxt", "mavlink"])
@pytest.mark.parametrize("flown", [pytest.param(SCENARIO_2, id="scenario-2")], indirect=True)
def test_other_programs_count_the_same_in_the_captures_of(flown: Run, protocol: str) -> None:
    attempt = attempt_over(flown, protocol)
    assert_tshark_agrees(attempt)
    assert_pymavlink_agrees(attempt)
