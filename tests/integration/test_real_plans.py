"""MQTT-XT puts plans onto a real PX4, flies them, and whoever is killed meanwhile (PX4_DIR=FOLDER)."""

from __future__ import annotations

import asyncio

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Arm, ClearPlan, Drone, Hold, Land, Mission, Outcome, Plan, StartMission, UploadPlan, Word
from mqttxt.drone.mavlink.autopilots import AUTOPILOTS
from mqttxt.protocol.plans import PLAN, PlanItem, PlanObject
from mqttxt.station.transfers import Staging
from tests.rigs.commanding import armable, fly, start
from tests.rigs.processes import eventually
from tests.rigs.px4 import FOLDER, HOLD
from tests.rigs.real_flights import Flight
from tests.simulation.plan_items import HOME, METRES, place, plain

pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(400),
    pytest.mark.skipif(not FOLDER, reason="PX4_DIR names no folder with bin/px4 and etc of a PX4"),
]

KIND = AUTOPILOTS[mavlink.MAV_AUTOPILOT_PX4]
UP_M = 12.0


def survey(items: int) -> tuple[PlanItem, ...]:
    """A takeoff, lines of 15 m with headings, holds and a change of speed, and a return: so many items in all."""
    corners = [(15.0 * (number // 2), 15.0 * (number % 4 in (1, 2))) for number in range(items - 3)]
    return (
        place(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, UP_M, 15.0, 0.0, 0.0, None),
        plain(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, 6.0, -1.0),
        *(place(mavlink.MAV_CMD_NAV_WAYPOINT, *at, UP_M, 0.0, 0.0, 0.0, None) for at in corners),
        plain(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH),
    )


FENCE = tuple(
    place(mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, *at, 0, 4.0)
    for at in ((-500, -500), (900, -500), (900, 500), (-500, 500))
)
RALLY = tuple(place(mavlink.MAV_CMD_NAV_RALLY_POINT, north_m, -20, 15) for north_m in (10, 30))
TWENTY = Plan(PlanObject(mission=survey(20), fence=FENCE, rally=RALLY))
LONG = Plan(PlanObject(mission=survey(400)))
DOWN = Plan(
    PlanObject(
        mission=(survey(20)[0], place(mavlink.MAV_CMD_NAV_LAND, 8, 0, 0, 0.0, 0.0, 0.0, None)), fence=(), rally=()
    )
)

AWAY_M = 40.0
AWAY = Plan(
    PlanObject(
        mission=(place(mavlink.MAV_CMD_NAV_TAKEOFF, 0, AWAY_M, UP_M, 15.0, 0.0, 0.0, None), survey(20)[-1]),
        fence=(),
        rally=(),
    )
)


async def upload(drone: Drone, plan: Plan) -> None:
    last = await drone.upload(plan)
    assert (last.word, last.reason) == (Word.COMPLETED, None)


def reached(drone: Drone, plan: Plan) -> int:
    """The item of this plan that the drone has reached last: it may say so of the mission before for a moment yet."""
    known = drone.state(Mission)
    return known.state.reached if known is not None and known.state.mission == plan.mission_hash else 0


async def follow_upload(drone: Drone, plan: Plan, words: list[Outcome]) -> None:
    """An upload whose words come one by one: what it is made of, so that it is known when items are written."""
    runner, view = drone._runner, drone._fog
    staging = Staging(view, drone.number, PLAN, plan.content.packed())
    await runner.transfer(staging, None)
    async for outcome in drone.send(UploadPlan(staging.hash)):
        words.append(outcome)


async def test_a_plan_is_uploaded_and_what_comes_back_is_the_plan(flight: Flight, drone: Drone) -> None:
    await upload(drone, TWENTY)
    found = await drone.download()
    assert found.content == TWENTY.content
    assert found.mission_hash == TWENTY.mission_hash
    await upload(drone, TWENTY)  # nothing is left to write
    assert (await drone.send(ClearPlan())).completed
    assert (await drone.download()).content == PlanObject(mission=(), fence=(), rally=())


async def test_a_mission_is_flown_paused_resumed_and_returns(flight: Flight, drone: Drone) -> None:
    await upload(drone, TWENTY)
    last = await drone.start_mission(TWENTY)
    assert (last.word, last.reason) == (Word.DENIED, "disarmed")
    await fly(drone, Arm())
    assert (await drone.start_mission(DOWN)).reason == "other_plan"
    heard = []

    async def follow() -> None:
        async for outcome in drone.start_mission(TWENTY):
            heard.append(outcome)

    started = asyncio.create_task(follow())
    await eventually(lambda: reached(drone, TWENTY) >= 5, "it is on its way", 90)
    last = await drone.upload(DOWN)
    assert (last.word, last.reason) == (Word.DENIED, "mission_running")
    assert (await drone.pause()).completed
    await started
    assert heard[-1].word is Word.SUPERSEDED
    assert flight.pilot.mode == HOLD
    assert flight.pilot.speed_m_s < 1.0
    assert (await drone.set_current_item(TWENTY, 17)).completed
    last = await drone.resume(TWENTY, limit_s=300)
    assert (last.word, last.reason) == (Word.COMPLETED, None)
    assert (flight.pilot.landed, flight.pilot.armed) == (True, False)


async def test_a_takeoff_elsewhere_is_reached_at_its_place(flight: Flight, drone: Drone) -> None:
    await upload(drone, AWAY)
    await fly(drone, Arm())
    heard, flown = await start(drone, StartMission(AWAY.mission_hash))
    await eventually(lambda: reached(drone, AWAY) >= 1, "the takeoff's item is reached", 60)
    known = drone.location
    assert known is not None
    assert (known.state.longitude_deg * 1e7 - HOME[1]) / METRES[1] > AWAY_M - 10
    await flown
    assert heard[-1].word is Word.COMPLETED


async def test_a_mission_that_lands_leaves_nothing_that_the_next_arming_flies(flight: Flight, drone: Drone) -> None:
    await upload(drone, DOWN)
    await fly(drone, Arm())
    last = await drone.start_mission(DOWN, limit_s=120)
    assert (last.word, last.reason) == (Word.COMPLETED, None)
    await eventually(lambda: flight.pilot.mode == HOLD, "it is put into hold", 5)
    await fly(drone, Arm(), Hold())
    assert flight.pilot.landed


async def test_a_pilots_mode_ends_a_mission(flight: Flight, drone: Drone) -> None:
    await upload(drone, TWENTY)
    await fly(drone, Arm())
    heard, task = await start(drone, StartMission(TWENTY.mission_hash))
    await eventually(lambda: flight.pilot.position_m[2] > 5, "it climbs", 60)
    flight.pilot.set_mode(flight.pilot.landing)
    await task
    assert (heard[-1].word, heard[-1].reason) == (Word.FAILED, "mode_changed")
    await fly(drone, Land())


async def test_a_client_that_is_killed_in_an_upload_leaves_the_old_plan(flight: Flight, drone: Drone) -> None:
    await upload(drone, DOWN)
    words: list[Outcome] = []
    task = asyncio.create_task(follow_upload(drone, LONG, words))
    await eventually(lambda: any(word.word is Word.IN_PROGRESS for word in words), "items are written")
    flight.uav.kill()
    flight.uav.start().wait_ready()
    await task
    assert (words[-1].word, words[-1].reason) == (Word.UNCONFIRMED, "restarted")
    await eventually(lambda: drone.is_controlled, "it is back")
    found = (await drone.download()).content  # by a client that does not know what was uploaded once: as PX4 keeps it
    assert found.mission is not None
    assert DOWN.content.mission is not None
    assert [*map(KIND.kept, found.mission)] == [*map(KIND.kept, DOWN.content.mission)]
    await upload(drone, TWENTY)


async def test_a_px4_that_is_killed_in_an_upload_is_not_said_to_have_it(flight: Flight, drone: Drone) -> None:
    words: list[Outcome] = []
    task = asyncio.create_task(follow_upload(drone, LONG, words))
    await eventually(lambda: any(word.word is Word.IN_PROGRESS for word in words), "items are written")
    flight.autopilot.kill()
    flight.start_autopilot()
    await task
    assert words[-1].word is Word.UNCONFIRMED
    assert words[-1].reason in ("autopilot_restarted", "autopilot_lost")
    await armable(drone)
    await fly(drone, Arm())
    last = await drone.start_mission(LONG)
    assert (last.word, last.reason) == (Word.DENIED, "other_plan")
    await upload(drone, TWENTY)
