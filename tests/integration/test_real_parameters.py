"""MQTT-XT reads and sets the parameters of a real PX4 and ArduCopter, beside a pilot's station that sets them too.

PX4_DIR=FOLDER and ARDUPILOT_DIR=FOLDER name them.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from mqttxt import Drone, Parameters, TransferFailed, Word
from tests.rigs.either_autopilot import flight_of
from tests.rigs.processes import eventually
from tests.rigs.real_flights import Flight

pytestmark = [pytest.mark.integration, pytest.mark.alone, pytest.mark.timeout(400)]


@dataclass(frozen=True)
class Names:
    """Parameters of a kind of autopilot that fly nothing where they are changed on the ground."""

    a_float: str
    a_whole: str
    guarded: str
    least: int


NAMES = {
    "px4": Names("MPC_XY_CRUISE", "RTL_CONE_ANG", "MAV_SYS_ID", 800),
    "copter": Names("WPNAV_SPEED", "RTL_LOIT_TIME", "SYSID_THISMAV", 1200),
}


@dataclass
class Tried:
    flight: Flight
    names: Names


@pytest.fixture(scope="module", params=["px4", "copter"])
def tried(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tried]:
    folder: Path = tmp_path_factory.mktemp("flight")
    flight = flight_of(request.param, folder)
    with flight:
        yield Tried(flight, NAMES[request.param])


@pytest.fixture
async def drone(tried: Tried) -> AsyncIterator[Drone]:
    async with tried.flight.drone() as drone:
        yield drone


async def test_the_set_is_whole_and_who_has_it_gets_it_at_once(
    tried: Tried, drone: Drone, capsys: pytest.CaptureFixture[str]
) -> None:
    times_s, found = [], None
    for _ in range(2):
        begun_s = time.monotonic()
        found = await drone.parameters(found)
        times_s.append(time.monotonic() - begun_s)
    assert found is not None
    assert len(found) > tried.names.least
    assert {tried.names.a_float, tried.names.a_whole, tried.names.guarded} <= {*found}
    with capsys.disabled():
        told = f"{len(found)} parameters, {len(found.content.packed())} bytes compressed"
        print(f"\n{told}: read in {times_s[0]:.1f} s, again in {times_s[1]:.2f} s")


async def test_parameters_are_set_and_read_back(tried: Tried, drone: Drone) -> None:
    before = await drone.parameters()
    for name, by in ((tried.names.a_float, 0.7), (tried.names.a_whole, 1)):
        last = await drone.set_parameter(name, before[name] + by)
        assert (last.word, last.reason) == (Word.COMPLETED, None)
        after = await drone.parameters(before)
        assert after[name] == pytest.approx(before[name] + by)
        assert (await drone.set_parameter(name, before[name])).completed


async def test_what_cannot_be_set_is_denied_in_a_line(tried: Tried, drone: Drone) -> None:
    last = await drone.set_parameter("NOBODY_HAS_IT", 1)
    assert (last.word, last.reason) == (Word.DENIED, "unknown_parameter")
    last = await drone.set_parameter(tried.names.a_whole, 1.5)
    assert last.word is Word.DENIED
    assert (last.reason or "").startswith("wrong_value, a whole number from ")
    last = await drone.set_parameter(tried.names.guarded, 9)
    assert (last.word, last.reason) == (Word.DENIED, "parameter_not_enabled")
    last = await drone.set_parameter(tried.names.guarded.lower(), 9)
    assert last.word is Word.DENIED


async def test_what_a_pilots_station_sets_is_in_the_set(tried: Tried, drone: Drone) -> None:
    before, name = await drone.parameters(), tried.names.a_float
    tried.flight.pilot.set_parameter(name, before[name] + 1)
    seen = before
    for _ in range(20):  # the autopilot hears the pilot in its own time
        seen = await drone.parameters(seen)
        if seen[name] != before[name]:
            break
    assert seen[name] == before[name] + 1
    assert (await drone.set_parameter(name, before[name])).completed


async def test_an_autopilot_that_is_killed_while_it_is_read_is_read_anew(tried: Tried, drone: Drone) -> None:
    before = await drone.parameters()
    tried.flight.uav.kill()  # its successor reads anew where there is no hash
    (tried.flight.folder / "uav.journal.parameters").unlink(missing_ok=True)
    tried.flight.uav.start().wait_ready()
    await eventually(lambda: drone.is_controlled, "it is back")
    reading = asyncio.create_task(drone.parameters())
    await asyncio.sleep(0)
    tried.flight.autopilot.kill()
    tried.flight.start_autopilot()
    try:
        found = await reading
    except TransferFailed:
        found = await _once_it_answers(drone)
    assert {*found} == {*before}


async def _once_it_answers(drone: Drone) -> Parameters:
    for _ in range(60):
        try:
            return await drone.parameters()
        except TransferFailed:
            await asyncio.sleep(1)
    raise AssertionError("it never answers")
