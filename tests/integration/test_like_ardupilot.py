"""MQTT-XT flies the stand-in as ArduPilot, in real time: every command, a velocity for its duration, a client's end."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from typing import Any

import pytest

from mqttxt import Arm, Disarm, Drone, Goto, GroundStation, Hold, Land, Offboard, Return, Takeoff, Velocity, Word
from mqttxt.protocol.states import Armed, Landed, LandedState
from tests.rigs.commanding import armable, fly, start
from tests.rigs.processes import System, eventually

pytestmark = pytest.mark.integration
FLIGHTS = pytest.mark.soak(
    "services/mqttxt/src/mqttxt/drone", "services/sitl/src/sitl/ardupilot", "services/sitl/src/sitl/px4"
)

HOME = (47.397742, 8.545594)
ON_GROUND = LandedState(Landed.ON_GROUND)


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    with closing(System(tmp_path_factory.mktemp("system"), like="ardupilot")) as made:
        yield made.start()


@pytest.fixture
async def drone(system: System) -> AsyncIterator[Drone]:
    """Drone 1 on the ground, disarmed, and under this station's control."""
    system.control(1, {"set": {"armed": False, "healthy": True}})
    async with GroundStation(system.cloud.url) as station:
        (fog,) = await station.connect([1])
        found = fog.drone(1)
        await armable(found)
        await eventually(lambda: _is_down(found), "its station knows it on the ground")
        yield found


def _is_down(drone: Drone) -> bool:
    armed, landed = drone.state(Armed), drone.state(LandedState)
    return armed is not None and landed is not None and (armed.state, landed.state) == (Armed(False), ON_GROUND)


def _state(system: System) -> dict[str, Any]:
    return system.control(1, {"get": "state"})


@FLIGHTS
async def test_every_command_is_flown_and_it_flies_again_after_a_landing(system: System, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(10.0))
    assert abs(_state(system)["altitude_m"] - 10) < 1
    await fly(drone, Goto(HOME[0] + 0.0004, HOME[1], 14.0), Hold(), Land())
    assert (_state(system)["armed"], _state(system)["mode"]) == (False, "land")
    await fly(drone, Arm(), Takeoff(5.0), Goto(HOME[0], HOME[1], 5.0), Return())
    assert (_state(system)["armed"], _state(system)["mode"]) == (False, "rtl")
    await fly(drone, Arm(), Disarm())


async def test_a_velocity_is_flown_for_its_duration_and_then_held(system: System, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(10.0))
    before = _state(system)["latitude_deg"]
    await fly(drone, Offboard(6.0, velocity=Velocity(3.0, 0.0, 0.0)))
    assert _state(system)["mode"] == "brake"
    assert 10 < (_state(system)["latitude_deg"] - before) * 111_195 < 25


@FLIGHTS
async def test_without_its_client_a_velocity_ends_by_itself(system: System, drone: Drone) -> None:
    """GUID_TIMEOUT: three seconds after the last set-point it stands."""
    await fly(drone, Arm(), Takeoff(10.0))
    heard, task = await start(drone, Offboard(60.0, velocity=Velocity(3.0, 0.0, 0.0)))
    await eventually(lambda: _state(system)["groundspeed_m_s"] > 2, "it flies")
    system.uavs[1].kill()
    await eventually(lambda: _state(system)["groundspeed_m_s"] < 0.5, "it stands", 15)
    system.uavs[1].start().wait_ready()
    await task
    assert (heard[-1].word, heard[-1].reason) == (Word.UNCONFIRMED, "restarted")
