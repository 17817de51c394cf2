"""A plan is staged, committed, read back, flown, paused and fetched, over all roles, with the stand-in as autopilot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.protocol.commands import Arm, ClearPlan, Hold, Pause, Resume, SetCurrentItem, StartMission, UploadPlan
from mqttxt.protocol.messages import Word
from mqttxt.protocol.plans import PLAN, PlanList, PlanObject, list_hash
from mqttxt.protocol.states import Mission
from mqttxt.station.transfers import Fetching, Staging
from sitl.personalities import PERSONALITIES
from tests.simulation.flight import Flight
from tests.simulation.plan_items import BACK, FENCE, RALLY, ROUND_TRIP, SQUARE, UP, place

pytestmark = pytest.mark.long


@pytest.fixture(params=PERSONALITIES)
def flight(request: pytest.FixtureRequest) -> Flight:
    return Flight().begin(request.param)


def stage(flight: Flight, data: bytes) -> Staging:
    staging = Staging(flight.gs.fog(1), 1, PLAN, data)
    flight.run("gs", flight.gs.transfers.begin(staging, flight.now_ms))
    flight.fly(1)
    return staging


def upload(flight: Flight, plan: PlanObject) -> tuple[Word, str | None]:
    staging = stage(flight, plan.packed())
    assert (staging.is_over, staging.error) == (True, None)
    return flight.outcome(UploadPlan(staging.hash))


def fetched(flight: Flight, seconds: float = 5) -> Fetching:
    """The end of a download of the plan."""
    fetching = Fetching(flight.gs.fog(1), 1, PLAN)
    flight.run("gs", flight.gs.transfers.begin(fetching, flight.now_ms))
    flight.fly(seconds)
    assert fetching.is_over
    return fetching


def fetch(flight: Flight) -> PlanObject:
    fetching = fetched(flight)
    assert fetching.error is None
    return PlanObject.unpacked(fetching.data)


def last_word(flight: Flight, sent: Any) -> tuple[Word, str | None] | None:
    """The last word on a command and its reason, None before it."""
    last = flight.last_of(sent)
    return None if last is None else (last.word, last.reason)


def mission_hash(plan: PlanObject) -> bytes:
    return list_hash(plan.mission or ())


def test_a_plan_is_uploaded_verified_fetched_and_cleared(flight: Flight) -> None:
    assert upload(flight, ROUND_TRIP) == (Word.COMPLETED, None)
    assert fetch(flight) == ROUND_TRIP
    assert flight.outcome(ClearPlan()) == (Word.COMPLETED, None)
    assert fetch(flight) == PlanObject(mission=(), fence=(), rally=())


def test_a_list_that_the_plan_does_not_have_is_left(flight: Flight) -> None:
    assert upload(flight, ROUND_TRIP) == (Word.COMPLETED, None)
    assert upload(flight, PlanObject(rally=())) == (Word.COMPLETED, None)
    assert fetch(flight) == replace(ROUND_TRIP, rally=())


def test_a_mission_is_flown_to_its_end(flight: Flight) -> None:
    assert upload(flight, ROUND_TRIP) == (Word.COMPLETED, None)
    assert flight.outcome(StartMission(mission_hash(ROUND_TRIP))) == (Word.DENIED, "disarmed")
    assert flight.outcome(Arm()) == (Word.COMPLETED, None)
    assert flight.outcome(StartMission(mission_hash(ROUND_TRIP)), 300) == (Word.COMPLETED, None)
    assert (flight.vehicle.autopilot.armed, flight.vehicle.autopilot.landed) == (False, True)
    told = flight.gs.fog(1).drones[1].states["mission"].message.state
    assert isinstance(told, Mission)
    assert (told.total, told.mission) == (5, mission_hash(ROUND_TRIP))


def test_a_mission_is_paused_resumed_and_begun_elsewhere(flight: Flight) -> None:
    plan = replace(ROUND_TRIP, mission=(UP, *SQUARE))
    assert upload(flight, plan) == (Word.COMPLETED, None)
    assert flight.outcome(Arm()) == (Word.COMPLETED, None)
    started = flight.send(StartMission(mission_hash(plan), 1))
    flight.fly(20)
    assert flight.outcome(Pause()) == (Word.COMPLETED, None)
    assert last_word(flight, started) == (Word.SUPERSEDED, None)
    assert flight.outcome(Pause()) == (Word.DENIED, "not_in_mission")
    assert flight.outcome(SetCurrentItem(mission_hash(plan), 4)) == (Word.COMPLETED, None)
    assert flight.outcome(Resume(mission_hash(plan)), 200) == (Word.COMPLETED, None)
    assert flight.vehicle.autopilot.motion.position[1] == pytest.approx(30, abs=3)
    assert flight.outcome(Hold()) == (Word.COMPLETED, None)


@pytest.mark.parametrize("command", [StartMission(bytes(16)), Resume(bytes(16)), SetCurrentItem(bytes(16), 1)])
def test_another_plan_than_the_one_that_is_named_is_not_begun(flight: Flight, command: Any) -> None:
    assert upload(flight, ROUND_TRIP) == (Word.COMPLETED, None)
    assert flight.outcome(Arm()) == (Word.COMPLETED, None)
    assert flight.outcome(command) == (Word.DENIED, "other_plan")
    too_far = replace(command, mission=mission_hash(ROUND_TRIP), **({} if isinstance(command, Resume) else {"item": 6}))
    if not isinstance(command, Resume):
        assert flight.outcome(too_far) == (Word.DENIED, "no_such_item, 5")


def test_what_somebody_else_uploaded_is_another_plan(flight: Flight) -> None:
    assert upload(flight, ROUND_TRIP) == (Word.COMPLETED, None)
    plans = flight.vehicle.autopilot.plans
    plans.put(PlanList.MISSION, plans.mission[:-1])
    assert flight.outcome(Arm()) == (Word.COMPLETED, None)
    assert flight.outcome(StartMission(mission_hash(ROUND_TRIP))) == (Word.DENIED, "other_plan")


def test_a_plan_that_the_autopilot_refuses_leaves_the_old_one(flight: Flight) -> None:
    assert upload(flight, ROUND_TRIP) == (Word.COMPLETED, None)
    wrong = PlanObject(fence=(), mission=(UP, replace(SQUARE[0], command=31_999), BACK))
    word, reason = upload(flight, wrong)
    assert word is Word.FAILED
    assert reason is not None
    assert reason.startswith("mission item 2: ")
    assert fetch(flight) == ROUND_TRIP


def test_a_mission_that_is_flown_is_not_replaced(flight: Flight) -> None:
    assert upload(flight, ROUND_TRIP) == (Word.COMPLETED, None)
    assert flight.outcome(Arm()) == (Word.COMPLETED, None)
    flight.send(StartMission(mission_hash(ROUND_TRIP)))
    flight.fly(20)
    assert upload(flight, PlanObject(mission=(UP,))) == (Word.DENIED, "mission_running")
    assert flight.outcome(ClearPlan()) == (Word.DENIED, "mission_running")


@pytest.mark.parametrize(
    ("plan", "reason"),
    [
        (PlanObject(fence=(*FENCE[:3], replace(FENCE[3], params=(None, *[0.0] * 3)))), "fence item 4: param1 is null"),
        (
            PlanObject(fence=(place(mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, 0, 0, 0, None),)),
            "fence item 1: param1 is null",
        ),
        (PlanObject(rally=(*RALLY, replace(RALLY[0], z=None))), "rally item 2: its altitude is null"),
        (PlanObject(mission=(UP, replace(SQUARE[0], z=None))), "mission item 2: its altitude is null"),
    ],
)
def test_an_item_that_lacks_a_number_reaches_no_autopilot(flight: Flight, plan: PlanObject, reason: str) -> None:
    assert upload(flight, plan) == (Word.DENIED, reason)
    assert fetch(flight) == PlanObject(mission=(), fence=(), rally=())


def test_what_was_not_staged_is_denied(flight: Flight) -> None:
    assert flight.outcome(UploadPlan(bytes(16))) == (Word.DENIED, "not_staged")
    staging = stage(flight, b"no plan at all")
    assert flight.outcome(UploadPlan(staging.hash))[0] is Word.DENIED
