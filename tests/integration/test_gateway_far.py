"""MAVSDK over the gateway on links of the profiles in `tc_profiles`: telemetry, parameters, missions, actions."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.plugins.action import ActionError
from mavsdk.plugins.mission import MissionError, MissionItem, MissionPlan
from mavsdk.plugins.param import ParamError

from sitl.px4.parameters import SPECS
from tests.integration.test_gateway_plans import M_PER_DEGREE, point
from tests.rigs.gateway import NAN, Flight, Ground, eventually, systems
from tests.simulation.far import FAR_LINKS, FarLink

SOURCES = ("services/mqttxt/src/mqttxt/gateway", "tests/rigs/far_link.py", "tests/simulation/far.py")
pytestmark = [pytest.mark.integration, pytest.mark.apart, pytest.mark.timeout(400), pytest.mark.soak(*SOURCES)]
MOST_TRIES = 4
TEXT_S = 2.0


@pytest.fixture(params=[pytest.param(link, id=link.name) for link in FAR_LINKS])
def link(request: pytest.FixtureRequest) -> FarLink:
    found: FarLink = request.param
    return found


@pytest.fixture
def ground(tmp_path: Path, link: FarLink) -> Iterator[Ground]:
    with contextlib.closing(Ground(tmp_path, link=link)) as system:
        yield system.start()


class Calls:
    """MAVSDK's calls, made again as its programs and people do: after its time-out, and where the command has expired.

    `late` are those that were. How long answers take on such links is simulated, in tests/unit/mqttxt/test_answers_far.
    """

    def __init__(self, flight: Flight) -> None:
        self.late: list[str] = []
        self._flight = flight

    async def make(self, name: str, call: Callable[[], Awaitable[Any]]) -> Any:
        for _ in range(MOST_TRIES):
            known = len(self._flight.texts)
            try:
                return await call()
            except (ActionError, MissionError, ParamError) as error:
                if "TIMEOUT" not in str(error) and not await self._has_expired(error, known):
                    raise
                self.late.append(name)
        raise AssertionError(f"{name}: late {MOST_TRIES} times")

    async def _has_expired(self, error: Exception, known: int) -> bool:
        """Whether a call was denied because its command came too late, which a text says beside the answer."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(TEXT_S):
                while "COMMAND_DENIED" in str(error):
                    if any(text.endswith("expired") for text in self._flight.texts[known:]):
                        return True
                    await asyncio.sleep(0.05)
        return False


async def test_mavsdk_reads_sets_uploads_and_flies_from_far_away(
    ground: Ground, mavsdk: Mavsdk, link: FarLink, capsys: pytest.CaptureFixture[str]
) -> None:
    system = (await systems(mavsdk))[1]
    flight, param, mission = Flight(system), ParamAsync(system), MissionAsync(system)
    telemetry, action, calls = flight.telemetry, flight.action, Calls(flight)
    await eventually(telemetry.health, lambda health: health.is_armable and health.is_home_position_ok)
    await eventually(telemetry.battery, lambda battery: battery.remaining_percent > 50)
    found = await calls.make("get_all_params", param.get_all_params)
    assert {one.name for one in (*found.int_params, *found.float_params)} == {*SPECS}
    await calls.make("set_param_float", lambda: param.set_param_float("MPC_XY_CRUISE", 11.0))
    assert await calls.make("get_param_float", lambda: param.get_param_float("MPC_XY_CRUISE")) == 11.0

    plan = MissionPlan([point(0, MissionItem.VehicleAction.TAKEOFF), *(point(4.0 * n) for n in range(1, 10))])
    await mission.set_return_to_launch_after_mission(True)
    await calls.make("upload_mission", lambda: mission.upload_mission(plan))
    await calls.make("arm", action.arm)
    await calls.make("start_mission", mission.start_mission)
    await eventually(mission.is_mission_finished, bool)
    await eventually(telemetry.armed, lambda armed: not armed)
    read = await calls.make("download_mission", mission.download_mission)
    assert [round(item.latitude_deg, 7) for item in read.mission_items] == [
        round(item.latitude_deg, 7) for item in plan.mission_items
    ]

    home = await eventually(telemetry.home, lambda home: home.absolute_altitude_m == home.absolute_altitude_m)
    await action.set_takeoff_altitude(6.0)

    async def lift_off() -> None:  # both again: a drone that waits for its takeoff disarms by itself
        await action.arm()
        await action.takeoff()

    await calls.make("takeoff", lift_off)
    await flight.said("takeoff completed")
    north = home.latitude_deg + 15 / M_PER_DEGREE
    to = (north, home.longitude_deg, home.absolute_altitude_m + 8.0, NAN)
    await calls.make("goto_location", lambda: action.goto_location(*to))
    await flight.said("goto completed")
    await eventually(telemetry.position, lambda position: abs(position.latitude_deg - north) < 1e-5)
    await calls.make("hold", action.hold)
    await calls.make("land", action.land)
    await eventually(telemetry.armed, lambda armed: not armed)
    flight.close()
    with capsys.disabled():
        print(f"\n{link.name}: MAVSDK's calls that were late: {', '.join(calls.late) or 'none'}")
