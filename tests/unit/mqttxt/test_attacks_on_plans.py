"""Attacks on a drone's plan: no mission is flown that was not commanded, and no autopilot's list ends the client."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.protocol.commands import Arm, ClearPlan, Pause, SetCurrentItem, StartMission, UploadPlan
from mqttxt.protocol.messages import Word
from mqttxt.protocol.plans import MOST_ITEMS, PlanList, PlanObject
from sitl.personalities import PERSONALITIES
from tests.simulation.flight import Flight
from tests.simulation.plan_items import ROUND_TRIP, SQUARE, UP
from tests.unit.mqttxt.test_flight_plans import fetched, last_word, mission_hash, stage, upload

pytestmark = pytest.mark.long

STAYS = replace(ROUND_TRIP, mission=(UP, *SQUARE))
SHORT = PlanObject(mission=(UP, SQUARE[0]))


class Attacked(Flight):
    """A flight in which some messages of the autopilot do not come, and some of the UAV client's do not arrive."""

    def begin(self, like: str) -> Attacked:
        super().begin(like)
        assert upload(self, STAYS) == (Word.COMPLETED, None)
        assert self.outcome(Arm()) == (Word.COMPLETED, None)
        self.written_ms.clear()
        return self

    def __post_init__(self) -> None:
        self.unheard: set[str] = set()
        self.lost: set[str] = set()
        self.written_ms: dict[str, list[int]] = {}
        super().__post_init__()

    @property
    def plans(self) -> Any:
        """The autopilot's own lists."""
        return self.vehicle.autopilot.plans

    def _hear(self, messages: list[Any]) -> None:
        super()._hear([message for message in messages if message.get_type() not in self.unheard])

    def _arrives(self, effect: Any) -> bool:
        kind = effect.message.get_type()
        if not super()._arrives(effect):
            return False
        self.written_ms.setdefault(kind, []).append(self.now_ms)
        return kind not in self.lost


@pytest.fixture(params=PERSONALITIES)
def flight(request: pytest.FixtureRequest) -> Attacked:
    return Attacked().begin(request.param)


@pytest.mark.parametrize("is_cleared", [False, True])
def test_a_mission_that_was_just_started_is_not_replaced_under_it(flight: Attacked, is_cleared: bool) -> None:
    staged, before = stage(flight, SHORT.packed()), len(flight.plans.mission)
    flight.unheard = {"HEARTBEAT"}  # PX4's comes up to a second after it has accepted the mode
    started = flight.send(StartMission(mission_hash(STAYS)))
    changed = flight.send(ClearPlan() if is_cleared else UploadPlan(staged.hash))
    flight.fly(0.9)
    flight.unheard.clear()
    flight.fly(5)
    assert flight.mode in ("MISSION", "AUTO")
    assert last_word(flight, changed) == (Word.DENIED, "mission_running")
    assert last_word(flight, started) is None
    assert len(flight.plans.mission) == before


@pytest.mark.parametrize("after_s", [0.0, 0.3])
def test_a_mission_that_was_just_started_is_paused(flight: Attacked, after_s: float) -> None:
    flight.unheard = {"HEARTBEAT"}
    started = flight.send(StartMission(mission_hash(STAYS)))
    flight.fly(after_s)
    paused = flight.send(Pause())
    flight.fly(0.6)
    flight.unheard.clear()
    flight.fly(8)
    assert last_word(flight, paused) == (Word.COMPLETED, None)
    assert last_word(flight, started) == (Word.SUPERSEDED, None)
    assert flight.mode not in ("MISSION", "AUTO")


def test_an_item_is_not_made_the_current_one_behind_the_deadline(flight: Attacked) -> None:
    flight.lost = {"MISSION_SET_CURRENT"}
    sent_ms = flight.now_ms
    assert flight.outcome(SetCurrentItem(mission_hash(STAYS), 3), ttl_ms=1200) == (Word.UNCONFIRMED, "no_ack")
    times = [at - sent_ms for at in flight.written_ms["MISSION_SET_CURRENT"]]
    assert len(times) >= 2
    assert max(times) <= 1200


def test_a_start_that_has_set_the_current_item_says_no_definite_no(flight: Attacked) -> None:
    flight.unheard = {"MISSION_CURRENT"}
    before = flight.plans.current
    assert flight.outcome(StartMission(mission_hash(STAYS), 3)) == (Word.FAILED, "expired")
    assert flight.plans.current != before


@pytest.mark.parametrize("bad", [math.inf, -math.inf])
def test_an_item_that_no_plan_can_have_ends_the_command_and_not_the_client(flight: Attacked, bad: float) -> None:
    flight.plans.put(PlanList.MISSION, (*flight.plans.mission[:-1], replace(flight.plans.mission[-1], z=bad)))
    number = len(flight.plans.mission)
    reason = f"mission item {number}: expected finite values"
    assert flight.outcome(StartMission(mission_hash(STAYS))) == (Word.DENIED, reason)
    assert flight.outcome(ClearPlan()) == (Word.FAILED, reason)
    assert fetched(flight).error == reason


@pytest.mark.parametrize("number", [MOST_ITEMS + 2, 65_535])
def test_a_list_that_is_too_long_is_not_read_to_its_end(flight: Attacked, number: int) -> None:
    flight.plans.put(PlanList.MISSION, (flight.plans.mission[0],) * number)
    reason = f"mission: expected at most {MOST_ITEMS} items, got {number}"
    assert flight.outcome(StartMission(mission_hash(STAYS))) == (Word.DENIED, reason)
    assert "MISSION_REQUEST_INT" not in flight.written_ms


def test_a_plan_that_is_too_long_to_be_given_ends_the_download_and_not_the_client(flight: Attacked) -> None:
    item = replace(flight.plans.mission[-1], params=(1.1, 2.2, 3.3, 4.4))
    flight.plans.put(PlanList.MISSION, (flight.plans.mission[0], *[item] * 1990))
    assert "expected at most" in str(fetched(flight, 60).error)


def test_answers_to_another_station_are_not_ours(flight: Attacked) -> None:
    """pymavlink's scripts are component 0 of system 255: what an autopilot answers them names that component."""
    staged = stage(flight, SHORT.packed())
    flight.lost = {"MISSION_COUNT", "MISSION_REQUEST_LIST"}
    changed = flight.send(UploadPlan(staged.hash))
    flight.fly(1)
    for kind in PlanList:
        flight._hear([mavlink.MAVLink_mission_count_message(255, 0, 0, kind)])
    flight.fly(0.1)
    assert "MISSION_COUNT" not in flight.written_ms, "nothing was read that could be compared"
    flight.lost.clear()
    flight.fly(5)
    assert last_word(flight, changed) == (Word.COMPLETED, None)
