"""An autopilot is flown into a starting state, from wherever it is; here the stand-in, in the places of both kinds."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from sitl.control_socket import served
from sitl.errors import SitlError
from sitl.fleet import DroneConfig
from sitl.likeness import pilot as piloting
from sitl.likeness import placing
from sitl.likeness.channel import Clock, SimulatedChannel
from sitl.likeness.manners import BY_REQUEST, MANNERS
from sitl.likeness.observer import Timeout
from sitl.likeness.pilot import Pilot
from sitl.likeness.placing import Placing, put
from sitl.likeness.procedures import FLIGHT_S, near
from sitl.personalities import PERSONALITIES
from sitl.process import LinkConfig, Process
from sitl.real.watching import Watching
from sitl.vehicle import Vehicle
from tests.rigs.processes import eventually, free_port


@pytest.fixture(params=sorted(MANNERS))
def flown(request: pytest.FixtureRequest) -> tuple[Vehicle, Pilot]:
    """An autopilot in simulated time, and who puts it into its places."""
    vehicle = Vehicle(DroneConfig(1), ["five-states"], like=PERSONALITIES[request.param])
    manners = replace(MANNERS[request.param], asks=BY_REQUEST)
    return vehicle, Pilot(SimulatedChannel(vehicle, 0, Clock()), manners, 1, greets=False)


def _stays(pilot: Pilot) -> None:
    """It is left where it is."""


def _arms(pilot: Pilot) -> None:
    put(pilot, armed=True, altitude_m=0)


def _hovers(pilot: Pilot) -> None:
    put(pilot, armed=True, altitude_m=20)


def _climbs(pilot: Pilot) -> None:
    _arms(pilot)
    pilot.takeoff(20)
    pilot.until("in the climb", lambda: pilot.position[2] > 5, FLIGHT_S)


def _goes_away(pilot: Pilot) -> None:
    _hovers(pilot)
    pilot.goto(60, 0, 20)
    pilot.until("there", near(pilot, 60, 20, 2), FLIGHT_S)


@pytest.mark.parametrize("before", [_stays, _arms, _hovers, _climbs, _goes_away])
@pytest.mark.parametrize(("armed", "altitude_m"), [(False, 0), (True, 0), (True, 10)])
def test_it_comes_into_every_starting_state_from_every_place(
    flown: tuple[Vehicle, Pilot], before: Callable[[Pilot], None], armed: bool, altitude_m: float
) -> None:
    vehicle, pilot = flown
    before(pilot)
    put(pilot, armed, altitude_m)
    state, _ = vehicle.control({"get": "state"})
    assert (state["armed"], state["mode"]) == (armed, pilot.manners.rest)
    assert state["altitude_m"] == pytest.approx(altitude_m, abs=1)
    home = vehicle.config.home
    away = (state["latitude_deg"] - home.latitude_deg, state["longitude_deg"] - home.longitude_deg)
    assert max(map(abs, away)) * 111_000 < 2 * placing.AT_HOME_M


def test_one_that_will_not_arm_is_commanded_again_and_then_named(
    flown: tuple[Vehicle, Pilot], monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle, pilot = flown
    monkeypatch.setattr(placing, "READY_S", 10.0)
    vehicle.control({"set": {"healthy": False}})
    with pytest.raises(Timeout, match=r"ready: not within 10 s"):
        put(pilot, armed=True, altitude_m=0)
    vehicle.control({"set": {"healthy": True}})
    put(pilot, armed=True, altitude_m=0)
    assert pilot.armed


@pytest.mark.long
async def test_an_autopilot_that_falls_silent_is_not_commanded_for_ever(
    witnessed: tuple[Watching, Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    watching, process = witnessed
    monkeypatch.setattr(placing, "PATIENCE", 1 / 60)
    monkeypatch.setattr(placing, "AGAIN_S", 0.1)
    monkeypatch.setattr(piloting, "ANSWER_S", 0.1)
    process.vehicle.control({"set": {"altitude_m": 1000}})
    tasks = [asyncio.create_task(watching.run()), asyncio.create_task(process.run())]
    await eventually(lambda: watching.witness.place is not None, "the autopilot is heard")
    placed = asyncio.create_task(Placing(watching, "px4").answer({"set": {"armed": False}}))
    await eventually(lambda: process.vehicle.control({"get": "state"})[0]["mode"] == "land", "it is brought down")
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    with pytest.raises(SitlError, match="disarmed: not within 120 s"):
        await placed


@pytest.mark.parametrize(
    "request_",
    [
        {"get": "state"},
        {"set": {}},
        {"set": {"armed": 1}},
        {"set": {"armed": True, "battery_pct": 100}},
        {"set": {"armed": True, "altitude_m": 1001}},
        {"set": {"armed": False, "altitude_m": 10}},
    ],
)
async def test_what_a_real_autopilot_cannot_be_put_into_is_refused_in_one_line(request_: Any, tmp_path: Path) -> None:
    watching = Watching(1, ("127.0.0.1", 0))
    async with served(tmp_path / "c.sock", Placing(watching, "px4").answer):
        answer = await _ask(tmp_path / "c.sock", request_)
    assert answer["error"].startswith(f"{request_}: of a real autopilot expected")
    watching.send(b"nobody is there yet")


async def _ask(path: Path, request: Any) -> dict[str, Any]:
    reader, writer = await asyncio.open_unix_connection(str(path))
    writer.write(json.dumps(request).encode() + b"\n")
    answer: dict[str, Any] = json.loads(await reader.readline())
    writer.close()
    return answer


@pytest.fixture
def witnessed(tmp_path: Path) -> tuple[Watching, Process]:
    """A process that talks to a witness alone, on the loopback."""
    port = free_port(socket.SOCK_DGRAM)
    links = [LinkConfig(("127.0.0.1", 0), ("127.0.0.1", port), "px4-onboard")]
    vehicle = Vehicle(DroneConfig(1), ["px4-onboard"], like=PERSONALITIES["px4"])
    return Watching(1, ("127.0.0.1", port)), Process(vehicle, links)


@pytest.mark.long
async def test_over_the_witnesss_link_it_is_armed_and_disarmed(
    witnessed: tuple[Watching, Process], tmp_path: Path
) -> None:
    watching, process = witnessed
    tasks = [asyncio.create_task(watching.run()), asyncio.create_task(process.run())]
    try:
        async with served(tmp_path / "c.sock", Placing(watching, "px4").answer):
            await eventually(lambda: watching.witness.heard_ns is not None, "the autopilot is heard")
            for armed in (True, False):
                answer = await _ask(tmp_path / "c.sock", {"set": {"armed": armed}})
                assert answer == {"armed": armed, "mode": "hold", "landed": True}
                assert process.vehicle.autopilot.armed == armed
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    assert watching.taps == []


async def test_a_flight_that_ends_meanwhile_is_not_waited_for(tmp_path: Path) -> None:
    watching = Watching(1, ("127.0.0.1", 0))
    answer = asyncio.create_task(Placing(watching, "px4").answer({"set": {"armed": True}}))
    await eventually(lambda: watching.taps != [], "it listens")
    answer.cancel()
    with pytest.raises(asyncio.CancelledError):
        await answer
    await asyncio.get_running_loop().shutdown_default_executor()
