"""Offboard against the stand-in autopilot: flown by set-points over both brokers, and left safely whatever is lost."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest

from mqttxt import Attitude, Drone, GroundStation, Offboard, Outcome, Velocity, Word
from tests.rigs.commanding import controlled, follow
from tests.rigs.processes import System, eventually

pytestmark = [pytest.mark.integration, pytest.mark.apart]
DRONE = pytest.mark.soak("services/mqttxt/src/mqttxt/drone", "services/mqttxt/src/mqttxt/activator")


@pytest.fixture
async def airborne(system: System) -> AsyncIterator[tuple[System, Drone]]:
    """Drone 1 hovers under control."""
    async with GroundStation(system.cloud.url) as station:
        drone = await controlled(station)
        assert (await drone.arm()).completed
        assert (await drone.takeoff(5.0)).completed
        yield system, drone


def _state(system: System) -> dict[str, Any]:
    return system.control(1, {"get": "state"})


def _modes(system: System) -> list[str]:
    lines = (system.folder / "sitl1.jsonl").read_text().splitlines()
    return [event["mode"] for event in map(json.loads, lines) if event["event"] == "mode"]


async def _engage(system: System, drone: Drone, command: Offboard) -> tuple[list[Outcome], asyncio.Task[None]]:
    heard, task = follow(drone.send(command))
    await eventually(lambda: _state(system)["mode"] == "offboard", "in offboard")
    return heard, task


async def test_a_velocity_is_flown_for_its_duration_and_then_held(airborne: tuple[System, Drone]) -> None:
    system, drone = airborne
    before = _state(system)
    last = await drone.send(Offboard(6.0, velocity=Velocity(3.0, 0.0, 0.0)))
    assert (last.word, last.reason) == (Word.COMPLETED, None)
    after = _state(system)
    north_m = (after["latitude_deg"] - before["latitude_deg"]) * 111_195
    assert 12 < north_m < 22
    assert _modes(system)[-2:] == ["offboard", "hold"]


@DRONE
async def test_an_attitude_is_flown(airborne: tuple[System, Drone]) -> None:
    system, drone = airborne
    before = _state(system)["altitude_m"]
    last = await drone.send(Offboard(2.0, attitude=Attitude(0.0, 0.0, 0.0, 0.8)))
    assert last.word is Word.COMPLETED
    assert _state(system)["altitude_m"] > before + 1
    assert _state(system)["mode"] == "hold"


async def test_a_pilot_takes_over_and_keeps_the_drone(airborne: tuple[System, Drone]) -> None:
    system, drone = airborne
    heard, task = await _engage(system, drone, Offboard(30.0, velocity=Velocity(1.0, 0.0, 0.0)))
    system.control(1, {"set": {"mode": "position"}})
    await task
    assert (heard[-1].word, heard[-1].reason) == (Word.FAILED, "mode_changed")
    assert _modes(system)[-2:] == ["offboard", "position"]


@pytest.mark.parametrize("lost", [pytest.param("activator", marks=DRONE), "fog", pytest.param("cloud", marks=DRONE)])
async def test_the_drone_holds_when_the_chain_behind_it_stalls(airborne: tuple[System, Drone], lost: str) -> None:
    system, drone = airborne
    heard, task = await _engage(system, drone, Offboard(60.0, velocity=Velocity(1.0, 0.0, 0.0)))
    part: Any = getattr(system, lost)
    part.stall()
    try:
        await eventually(lambda: _state(system)["mode"] == "hold", "the drone holds", 10)
    finally:
        part.go_on()
    await task
    assert (heard[-1].word, heard[-1].reason) == (Word.FAILED, "lease_lost")
    assert _modes(system)[-2:] == ["offboard", "hold"]
