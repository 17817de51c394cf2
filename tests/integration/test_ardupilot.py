"""MQTT-XT flies a real ArduCopter: every command, the refusals, and whoever is killed (ARDUPILOT_DIR=FOLDER)."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import (
    Arm,
    Disarm,
    Drone,
    Goto,
    Hold,
    Land,
    Mission,
    Offboard,
    Plan,
    Resume,
    Return,
    StartMission,
    Takeoff,
    Velocity,
    Word,
)
from mqttxt.protocol.plans import PlanObject
from tests.rigs.commanding import armable, fly, is_armable, start
from tests.rigs.copter import BRAKE, FOLDER, GUIDED, LAND, LOITER, RTL, Copter, CopterPilot
from tests.rigs.processes import eventually
from tests.rigs.real_flights import HOME, Flight
from tests.simulation.plan_items import place

pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(400),
    pytest.mark.skipif(not FOLDER, reason="ARDUPILOT_DIR names no folder with arducopter and copter.parm"),
]

NORTH_100_M = Goto(HOME[0] + 0.0009, HOME[1], 15.0)
UP = place(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 8.0, 0.0, 0.0, 0.0, None)
FIRST_M, LAST_M = 12.0, 30.0
STRAIGHT = Plan(
    PlanObject(
        mission=(UP, *(place(mavlink.MAV_CMD_NAV_WAYPOINT, at, 0, 8.0, 2.0) for at in (FIRST_M, LAST_M))),
        fence=(),
        rally=(),
    )
)
"""Two places to the north; the drone waits for 2 s at each."""
ONLY_UP = Plan(PlanObject(mission=(UP,), fence=(), rally=()))


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    folder = tmp_path_factory.mktemp("flight")
    autopilot = Copter(folder)
    with Flight(folder, autopilot, CopterPilot(autopilot.pilots_port)) as made:
        yield made


async def test_every_command_is_flown_and_it_flies_again_after_a_landing(flight: Flight, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(10.0))
    assert abs(flight.pilot.position_m[2] - 10.0) < 1.0
    await fly(drone, Goto(HOME[0] + 0.0004, HOME[1] + 0.0003, 14.0))
    north_m, east_m, up_m = flight.pilot.position_m
    assert (abs(north_m - 44.5) < 3, abs(east_m - 22.6) < 3, abs(up_m - 14.0) < 1.5) == (True, True, True)
    await fly(drone, Hold(), Land())
    assert (flight.pilot.armed, flight.pilot.mode) == (False, LAND)
    await fly(drone, Arm(), Takeoff(5.0))
    armed_at = flight.pilot.position_m
    await fly(drone, Goto(HOME[0], HOME[1], 5.0), Return())
    assert (flight.pilot.armed, flight.pilot.mode) == (False, RTL)
    north_m, east_m, _ = (now - then for now, then in zip(flight.pilot.position_m, armed_at, strict=True))
    assert (abs(north_m) < 3, abs(east_m) < 3) == (True, True), "where it was armed"
    await fly(drone, Arm(), Disarm())


async def test_a_mission_is_over_behind_its_last_item_and_flown_again_by_a_resume(flight: Flight, drone: Drone) -> None:
    flight.pilot.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, 1e6)
    assert (await drone.upload(STRAIGHT)).completed
    await fly(drone, Arm(), StartMission(STRAIGHT.mission_hash))
    assert flight.pilot.position_m[0] > LAST_M - 1.5
    assert flight.pilot.latest["MISSION_ITEM_REACHED"].seq == 3
    assert flight.pilot.latest["MISSION_CURRENT"].total == 3, "home, which is item 0, does not count"
    end = Mission(current=3, reached=3, total=3, mission=STRAIGHT.mission_hash)
    await eventually(lambda: (told := drone.state(Mission)) is not None and told.state == end, "the station knows")
    await fly(drone, Hold())
    assert (await drone.set_current_item(STRAIGHT, 1)).completed
    heard, task = await start(drone, Resume(STRAIGHT.mission_hash))
    await eventually(lambda: task.done() or flight.pilot.position_m[0] < FIRST_M + 3, "it flies back")
    assert not task.done()
    await task
    assert heard[-1].word is Word.COMPLETED
    assert flight.pilot.position_m[0] > LAST_M - 1.5
    await fly(drone, Land())


async def test_a_mission_of_one_item_is_over(flight: Flight, drone: Drone) -> None:
    assert (await drone.upload(ONLY_UP)).completed
    await fly(drone, Arm(), StartMission(ONLY_UP.mission_hash))
    assert flight.pilot.position_m[2] > 7
    await fly(drone, Land())


async def test_hold_stops_a_goto_and_stays(flight: Flight, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(10.0))
    heard, task = await start(drone, NORTH_100_M)
    await eventually(lambda: flight.pilot.speed_m_s > 6, "it is on its way")
    await fly(drone, Hold())
    await task
    assert heard[-1].word is Word.SUPERSEDED
    assert flight.pilot.mode == BRAKE
    assert flight.pilot.speed_m_s < 1.0
    held_at = flight.pilot.position_m
    await asyncio.sleep(5)
    assert max(abs(now - then) for now, then in zip(flight.pilot.position_m, held_at, strict=True)) < 1.5


async def test_on_the_ground_nothing_but_a_takeoff_takes_off(flight: Flight, drone: Drone) -> None:
    for command in (Takeoff(10.0), NORTH_100_M, Offboard(5.0, velocity=Velocity(0.0, 0.0, -1.0))):
        last = await drone.send(command)
        assert last.word is Word.DENIED, command
    await fly(drone, Hold(), Arm())
    assert (await drone.send(NORTH_100_M)).word is Word.DENIED
    await fly(drone, Hold(), Disarm())
    assert flight.pilot.highest_m < 0.5


async def test_what_it_refuses_is_denied(flight: Flight, drone: Drone) -> None:
    flight.pilot.set_mode(GUIDED)  # in another one `arm` changes the mode first, and is failed where it is refused
    await eventually(lambda: flight.pilot.mode == GUIDED, "the mode in which it arms")
    flight.pilot.set_parameter("SIM_GPS_DISABLE", 1.0)
    try:
        await eventually(lambda: not is_armable(drone), "it would not arm", 60)
        last = await drone.send(Arm())
        assert last.word is Word.DENIED
        assert (last.reason or "").startswith("autopilot: Arm: ")
    finally:
        flight.pilot.set_parameter("SIM_GPS_DISABLE", 0.0)
    await armable(drone)


async def test_a_velocity_is_flown_for_its_duration_and_then_held(flight: Flight, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(10.0))
    south_m = flight.pilot.position_m[0]
    await fly(drone, Offboard(6.0, velocity=Velocity(3.0, 0.0, 0.0)))
    assert flight.pilot.mode == BRAKE
    await eventually(lambda: flight.pilot.speed_m_s < 0.5, "it stands")
    assert 10 < flight.pilot.position_m[0] - south_m < 25
    await fly(drone, Land())


async def test_a_pilots_mode_ends_what_runs_with_the_next_heartbeat(flight: Flight, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(10.0))
    for command in (NORTH_100_M, Offboard(30.0, velocity=Velocity(-1.0, 0.0, 0.0))):
        heard, task = await start(drone, command)
        await eventually(lambda: flight.pilot.speed_m_s > 0.8, "it is on its way")
        taken_at = time.monotonic()
        flight.pilot.set_mode(BRAKE)
        await task
        assert time.monotonic() - taken_at < 1.0
        assert (heard[-1].word, heard[-1].reason) == (Word.FAILED, "mode_changed")
        assert flight.pilot.mode == BRAKE
    await fly(drone, Land())


async def test_a_pilot_who_takes_the_mode_before_a_takeoff_keeps_it(flight: Flight, drone: Drone) -> None:
    flight.pilot.set_mode(LOITER)
    await eventually(lambda: flight.pilot.mode == LOITER, "the pilot's mode")
    await fly(drone, Arm())
    asked = asyncio.ensure_future(drone.send(Takeoff(10.0)))
    await eventually(lambda: flight.pilot.mode == GUIDED or asked.done(), "the mode for the takeoff")
    while not asked.done():
        flight.pilot.set_mode(LOITER)
        await asyncio.sleep(0.02)
    last = await asked
    assert (last.word, last.reason) == (Word.FAILED, "mode_changed")
    await eventually(lambda: flight.pilot.mode == LOITER, "the pilot's mode")
    assert flight.pilot.highest_m < 0.5
    await fly(drone, Disarm())


async def test_without_its_client_a_velocity_ends_by_itself(flight: Flight, drone: Drone) -> None:
    """GUID_TIMEOUT: three seconds after the last set-point it stands."""
    await fly(drone, Arm(), Takeoff(10.0))
    heard, task = await start(drone, Offboard(60.0, velocity=Velocity(3.0, 0.0, 0.0)))
    await eventually(lambda: flight.pilot.speed_m_s > 2, "it flies")
    flight.uav.kill()
    await eventually(lambda: flight.pilot.speed_m_s < 0.5, "it stands", 15)
    flight.uav.start().wait_ready()
    await task
    assert (heard[-1].word, heard[-1].reason) == (Word.UNCONFIRMED, "restarted")
    await eventually(lambda: drone.is_controlled and "landed_state" in drone.states, "it is back")
    await fly(drone, Land())


async def test_an_autopilot_that_starts_anew_is_asked_anew(flight: Flight, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(10.0))
    heard, task = await start(drone, NORTH_100_M)
    flight.autopilot.kill()
    assert (await drone.send(Hold(), ttl_s=10)).word is not Word.COMPLETED
    flight.start_autopilot()
    await task
    assert heard[-1].word in (Word.UNCONFIRMED, Word.FAILED)
    await eventually(lambda: not is_armable(drone), "its new state is told", 60)
    await armable(drone)
    await fly(drone, Arm(), Takeoff(5.0), Land())
