"""The UAV client knows its drone whatever the autopilot streams by itself: it asks for what it misses."""

from __future__ import annotations

from pathlib import Path

import pytest

from mqttxt import Arm, GroundStation, Land, Stream, Takeoff
from tests.rigs.processes import System, eventually

pytestmark = pytest.mark.integration
OTHERS = pytest.mark.soak("services/mqttxt/src/mqttxt/drone", "services/sitl/src/sitl/streams.py")
STATES = frozenset(
    {"armed", "battery", "flight_mode", "groundspeed", "heading", "health", "home", "landed_state", "location"}
)


@pytest.mark.parametrize(
    "streams", ["px4-onboard", *(pytest.param(streams, marks=OTHERS) for streams in ("px4-gcs", "five-states"))]
)
async def test_every_state_comes_and_a_flight_is_completed(streams: str, tmp_path: Path) -> None:
    system = System(tmp_path, streams=streams)
    try:
        system.start()
        async with GroundStation(system.cloud.url) as station:
            await station.connect([1])
            drone = station.fog(1).drone(1)
            await eventually(lambda: drone.is_reachable and set(drone.states) >= STATES, "every state was told")
            for command in (Stream("battery", 1.0), Arm(), Takeoff(3.0), Land()):
                assert (await drone.send(command)).completed, command.name
    finally:
        system.close()
