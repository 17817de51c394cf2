"""MQTT-XT flies a real PX4: what it must not do, what stops it, pilots, and whoever is killed (PX4_DIR=FOLDER)."""

from __future__ import annotations

import asyncio
import time

import pytest

from mqttxt import Arm, Command, Disarm, Drone, Goto, Hold, Land, Offboard, Outcome, Return, Takeoff, Velocity, Word
from mqttxt.protocol.states import FlightMode, FlightModeName
from tests.rigs.commanding import armable, fly, is_armable, start
from tests.rigs.processes import eventually
from tests.rigs.px4 import FOLDER, HOLD, LAND, OFFBOARD, RETURN, TAKEOFF
from tests.rigs.real_flights import HOME, Flight

pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(400),
    pytest.mark.skipif(not FOLDER, reason="PX4_DIR names no folder with bin/px4 and etc of a PX4"),
]

NORTH, SOUTH = (Goto(HOME[0] + by_deg, HOME[1], 15.0) for by_deg in (0.002, -0.002))
SOUTHWARDS = Offboard(60.0, velocity=Velocity(-2.0, 0.0, 0.0))
REFUSED = "temporarily_rejected"
FLIGHTS: dict[str, tuple[Command, tuple[int, int]]] = {
    "takeoff": (Takeoff(25.0), TAKEOFF),
    "goto": (NORTH, HOLD),
    "land": (Land(), LAND),
    "return": (Return(), RETURN),
    "offboard": (SOUTHWARDS, OFFBOARD),
}


def shown_mode(drone: Drone) -> FlightModeName | None:
    known = drone.state(FlightMode)
    return known.state.mode if known is not None else None


async def _begin(flight: Flight, drone: Drone, name: str) -> tuple[list[Outcome], asyncio.Task[None]]:
    """Fly until a command is under way, which a heartbeat shows."""
    command, mode = FLIGHTS[name]
    await fly(drone, Arm())
    if name != "takeoff":
        await fly(drone, Takeoff(15.0))
    if name == "return":
        await fly(drone, Goto(HOME[0] + 0.0005, HOME[1], 15.0))
    heard, task = await start(drone, command)
    moves = {"takeoff": lambda: flight.pilot.position_m[2] > 3, "land": lambda: flight.pilot.position_m[2] < 14}
    is_moving = moves.get(name, lambda: flight.pilot.speed_m_s > 1)
    await eventually(lambda: flight.pilot.mode == mode and is_moving(), f"{name} is under way")
    return heard, task


async def test_a_takeoff_while_disarmed_does_not_climb_with_the_next_arm(flight: Flight, drone: Drone) -> None:
    ground_m = flight.pilot.highest_m
    last = await drone.send(Takeoff(10.0))
    assert (last.word, last.reason) == (Word.DENIED, "disarmed")
    await fly(drone, Arm())
    last = await drone.send(NORTH)
    assert (last.word, last.reason) == (Word.DENIED, "on_ground")
    await fly(drone, Hold())
    await asyncio.sleep(3)
    assert (flight.pilot.mode, flight.pilot.landed) == (HOLD, True)
    assert flight.pilot.highest_m - ground_m < 1.0
    await fly(drone, Disarm())


@pytest.mark.parametrize("name", ["land", "return"])
async def test_an_arm_that_puts_it_into_hold_first_does_not_undo_a_newer_mode(
    flight: Flight, drone: Drone, name: str
) -> None:
    newer, mode = FLIGHTS[name]
    flight.pilot.set_mode(TAKEOFF)
    await eventually(lambda: flight.pilot.mode == TAKEOFF, "an armed drone would climb")
    await eventually(lambda: shown_mode(drone) is FlightModeName.TAKEOFF, "the UAV client knows")
    arm, last = await asyncio.gather(drone.send(Arm()), drone.send(newer))
    assert (arm.word, arm.reason) in [(Word.DENIED, "mode_changed"), (Word.FAILED, "mode_changed")]
    assert last.word is not Word.DENIED
    await eventually(lambda: flight.pilot.mode == mode, f"{name} is the mode")
    await asyncio.sleep(1.5)  # in which a hold of the arm would be written three times
    assert (flight.pilot.mode, flight.pilot.armed) == (mode, False)
    await fly(drone, Hold())


async def test_its_refusal_in_the_air_is_quoted_and_hold_stops_a_goto_and_stays(flight: Flight, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(15.0))
    last = await drone.send(Disarm())
    assert (last.word, last.reason) == (Word.DENIED, f"{REFUSED}: Disarming denied: not landed")
    for there in (NORTH, SOUTH):
        heard, task = await start(drone, there)
        await eventually(lambda: flight.pilot.speed_m_s > 4.0, "it is on its way")
        told_at, from_m = time.monotonic(), flight.pilot.position_m
        await fly(drone, Hold())
        assert time.monotonic() - told_at < 6.0  # five to stand still, and one that shows it
        await task
        assert heard[-1].word is Word.SUPERSEDED
        held_m = flight.pilot.position_m
        assert abs(held_m[0] - from_m[0]) < 20
        await asyncio.sleep(5)
        assert (
            max(abs(now - then) for now, then in zip(flight.pilot.position_m, held_m, strict=True)) < 3
        )  # its estimate drifts, too
    await fly(drone, Land())


async def test_without_gps_it_is_not_armable_within_three_seconds_and_would_not_arm(
    flight: Flight, drone: Drone
) -> None:
    flight.pilot.set_whole_parameter("SIM_GPS_USED", 0)
    try:
        await eventually(lambda: not is_armable(drone), "the station knows", 3)
        await eventually(lambda: not flight.pilot.would_arm, "PX4 says so", 30)
        assert not is_armable(drone)
        last = await drone.send(Arm())
        assert (last.word, last.reason) == (
            Word.DENIED,
            f"{REFUSED}: Arming denied: Resolve system health failures first",
        )
    finally:
        flight.pilot.set_whole_parameter("SIM_GPS_USED", 10)
    await armable(drone)


async def test_a_px4_that_disarms_as_it_lands_has_landed(flight: Flight, drone: Drone) -> None:
    flight.pilot.set_parameter("COM_DISARM_LAND", 0.1)
    try:
        for down in (Land(), Return()):
            await fly(drone, Arm(), Takeoff(5.0), down)
            assert flight.pilot.landed
            await eventually(lambda: not flight.pilot.armed, "PX4's next heartbeat says so", 5)
    finally:
        flight.pilot.set_parameter("COM_DISARM_LAND", 2.0)


@pytest.mark.parametrize("name", FLIGHTS)
async def test_a_pilots_mode_ends_what_runs_with_the_next_heartbeat(flight: Flight, drone: Drone, name: str) -> None:
    heard, task = await _begin(flight, drone, name)
    mode = RETURN if name == "land" else LAND
    taken_at = time.monotonic()
    flight.pilot.set_mode(mode)
    await task
    assert time.monotonic() - taken_at < 1.3  # heartbeats come once a second, by PX4's own clock
    assert (heard[-1].word, heard[-1].reason) == (Word.FAILED, "mode_changed")
    await eventually(lambda: flight.pilot.mode == mode, "the pilot's own link shows it too")
    await fly(drone, Land())


@pytest.mark.parametrize("name", FLIGHTS)
async def test_after_the_client_was_killed_nobody_knows_and_hold_works(flight: Flight, drone: Drone, name: str) -> None:
    heard, task = await _begin(flight, drone, name)
    flight.uav.kill()
    flight.uav.start().wait_ready()
    await task
    assert (heard[-1].word, heard[-1].reason) == (Word.UNCONFIRMED, "restarted")
    await eventually(lambda: drone.is_controlled and "landed_state" in drone.states, "it is back")
    await fly(drone, Hold(), Land())


@pytest.mark.parametrize("name", FLIGHTS)
async def test_a_px4_that_is_killed_completes_nothing_and_is_flown_anew(
    flight: Flight, drone: Drone, name: str
) -> None:
    heard, task = await _begin(flight, drone, name)
    flight.autopilot.kill()
    flight.start_autopilot()
    await task
    lost = [(Word.UNCONFIRMED, "autopilot_restarted")]
    if name == "offboard":  # it goes on by the mode and the motors, and without them for three seconds
        lost = [(Word.UNCONFIRMED, "autopilot_lost"), (Word.FAILED, "disarmed"), (Word.FAILED, "mode_changed")]
    assert (heard[-1].word, heard[-1].reason) in lost
    await armable(drone)
    await fly(drone, Arm(), Disarm())


@pytest.mark.parametrize("name", ["goto", "land", "return"])
async def test_a_px4_that_stays_away_ends_what_runs_after_ten_seconds(flight: Flight, drone: Drone, name: str) -> None:
    heard, task = await _begin(flight, drone, name)
    flight.autopilot.kill()
    killed_at = time.monotonic()
    await task
    assert 8.5 < time.monotonic() - killed_at < 11.5  # the last heartbeat was up to a second before
    assert (heard[-1].word, heard[-1].reason) == (Word.UNCONFIRMED, "autopilot_lost")
    flight.start_autopilot()
    await armable(drone)
