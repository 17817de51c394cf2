"""A mission that was flown before is begun, resumed or read, with an autopilot that is made up (section 16)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.effects import Transmit
from mqttxt.drone.mavlink.mission_protocol import message_of
from mqttxt.protocol.commands import ClearPlan, Command, Resume, SetCurrentItem, StartMission
from mqttxt.protocol.messages import Word
from mqttxt.protocol.plans import MOST_ITEMS, PlanItem, PlanList, list_hash
from tests.simulation.plan_items import SQUARE
from tests.simulation.workbench import Bench, said, written
from tests.simulation.world import ack, from_autopilot, home, landed, position, transmitted
from tests.simulation.world import heartbeat as px4_heartbeat
from tests.unit.mqttxt.test_ardupilot import GUIDED, heartbeat

HASH = list_hash(SQUARE)
CLIENT = (1, 191)
AIR, MODE, MISSION_START, AUTO = 2, 176, 300, 3
DENIED = 2
PX4_HOLD, PX4_MISSION = px4_heartbeat(armed=True), px4_heartbeat(armed=True, main=4, sub=4)


class Planned(Bench):
    """A drone in the air whose autopilot has `items` behind `before` others in each list."""

    def __init__(self, first_heartbeat: Any, before: int, items: Sequence[PlanItem] = SQUARE) -> None:
        super().__init__(first_heartbeat, home(), position(20.0), landed(AIR))
        self.before, self.items = before, [items[0]] * before + [*items]

    def current(self, item: int) -> Any:
        total = len(self.items) - self.before
        return from_autopilot(mavlink.MAVLink_mission_current_message(item - 1 + self.before, total))

    def reached(self, item: int) -> Any:
        return from_autopilot(mavlink.MAVLink_mission_item_reached_message(item - 1 + self.before))

    def begin(self, command: Command) -> list[Any]:
        """Start a command, and answer what it writes to read the mission or to set the current item."""
        return self.answered(self.start(1, command) + self.until(self.now_ms + 200)) + self.until(self.now_ms + 200)

    def answered(self, out: list[Any]) -> list[Any]:
        every = list(out)
        while told := [one for each in out if isinstance(each, Transmit) for one in self.answers_to(each.message)]:
            out = self.hear(*map(from_autopilot, told))
            every += out
        return every

    def answers_to(self, message: Any) -> list[Any]:
        kind = message.get_type()
        if kind == "MISSION_REQUEST_LIST":
            return [mavlink.MAVLink_mission_count_message(*CLIENT, len(self.items), message.mission_type)]
        if kind == "MISSION_REQUEST_INT":
            return [message_of(self.items[message.seq], CLIENT, message.seq, PlanList(message.mission_type))]
        return [self.current(message.seq + 1 - self.before)] if kind == "MISSION_SET_CURRENT" else []


PX4 = (PX4_HOLD, 0, MODE, (ack(MODE), ack(MODE), PX4_HOLD, PX4_MISSION))
COPTER = (heartbeat(GUIDED, armed=True), 1, MISSION_START, (ack(MISSION_START), heartbeat(AUTO, armed=True)))


@pytest.mark.parametrize(("first_heartbeat", "before", "number", "answers"), [PX4, COPTER])
@pytest.mark.parametrize("current", [1, 3])
def test_what_an_earlier_flight_reached_completes_no_resume(
    first_heartbeat: Any, before: int, number: int, answers: Sequence[Any], current: int
) -> None:
    """Somebody else, or the landing, has set the item 1; an ArduCopter begins anew after its last item too."""
    bench = Planned(first_heartbeat, before)
    bench.hear(bench.current(3), bench.reached(3), bench.current(current))
    out = bench.begin(Resume(HASH))
    assert set(written(out)) == {number}
    out = bench.hear(*answers)
    for _ in range(20):  # it stands until it has turned
        out += bench.until(bench.now_ms + 100) + bench.hear(position(20.0))
    assert said(out) == [(1, Word.ACCEPTED, None)]


@pytest.mark.parametrize(("is_set", "word"), [(True, Word.FAILED), (False, Word.DENIED)])
def test_a_start_whose_item_was_set_has_no_definite_no(is_set: bool, word: Word) -> None:
    """A drone that flies its mission goes to that item at once (R16.12)."""
    bench = Planned(PX4_HOLD, 0)
    out = bench.start(1, StartMission(HASH, 2)) + bench.until(bench.now_ms + 200)
    while True:
        for one in transmitted(out) if is_set else []:
            bench.executor.on_transmitted(one.ref, bench.now_ms)
        answers = [one for each in out if isinstance(each, Transmit) for one in bench.answers_to(each.message)]
        if not answers:
            break
        out = bench.hear(*map(from_autopilot, answers))
    bench.until(bench.now_ms + 200)
    assert said(bench.refuse(ack(MODE, DENIED))) == [(1, word, "autopilot")]


def test_an_autopilot_that_starts_anew_behind_the_reading_flies_no_mission() -> None:
    """It may have another one (R16.12)."""
    bench = Planned(PX4_HOLD, 0)
    bench.answered(bench.start(1, Resume(HASH)) + bench.until(bench.now_ms + 100))
    bench.vehicle.boots.restarts += 1
    out = bench.until(bench.now_ms + 1000)
    assert (written(out), said(out)) == ([], [(1, Word.DENIED, "autopilot_restarted")])


def test_what_the_autopilot_tells_another_station_is_not_taken_for_the_mission() -> None:
    """A shorter list would be read, and be another plan (R16.19)."""
    bench = Planned(PX4_HOLD, 0)
    bench.start(1, SetCurrentItem(HASH, 1))
    for other in ((255, 190), (1, 192)):
        foreign = mavlink.MAVLink_mission_count_message(*other, 0, PlanList.MISSION)
        assert bench.hear(from_autopilot(foreign)) == []
    to_all = mavlink.MAVLink_mission_count_message(0, 0, len(bench.items), PlanList.MISSION)
    assert said(bench.answered(bench.hear(from_autopilot(to_all))))[-1] == (1, Word.COMPLETED, None)


def test_a_mission_that_is_set_back_is_not_over() -> None:
    bench = Planned(PX4_MISSION, 0)
    bench.hear(bench.current(3), bench.reached(3))
    out = bench.begin(SetCurrentItem(HASH, 2))
    assert said(out)[-1] == (1, Word.COMPLETED, None)
    assert not bench.vehicle.mission.is_over


def test_a_mission_that_is_started_has_reached_nothing() -> None:
    bench = Planned(PX4_HOLD, 0)
    bench.hear(bench.reached(2), bench.current(3))
    bench.begin(StartMission(HASH, 3))
    assert bench.vehicle.mission.reached == 0


def test_a_mission_is_not_started_while_its_lists_are_replaced() -> None:
    bench = Planned(PX4_HOLD, 0)
    bench.start(1, ClearPlan())
    assert said(bench.start(2, Resume(HASH))) == [(2, Word.DENIED, "plan_busy")]


def test_a_mission_that_goes_on_keeps_what_it_has_reached() -> None:
    bench = Planned(PX4_HOLD, 0)
    bench.hear(bench.reached(2), bench.current(3))
    bench.begin(Resume(HASH))
    assert bench.vehicle.mission.reached == 2


@pytest.mark.parametrize("number", [MOST_ITEMS, MOST_ITEMS + 1])
@pytest.mark.parametrize(("first_heartbeat", "before"), [PX4[:2], COPTER[:2]])
def test_a_list_one_item_too_long_ends_the_reading_and_not_the_queue(
    first_heartbeat: Any, before: int, number: int
) -> None:
    bench = Planned(first_heartbeat, before, SQUARE[:1] * number)
    too_long = f"mission: expected at most {MOST_ITEMS} items, got {before + number}"
    reason = too_long if number > MOST_ITEMS else "other_plan"
    assert said(bench.begin(Resume(HASH))) == [(1, Word.DENIED, reason)]
    bench.items = [SQUARE[0]] * before + [*SQUARE]
    assert said(bench.answered(bench.start(2, SetCurrentItem(HASH, 1))))[-1] == (2, Word.COMPLETED, None)


class Clearing(Planned):
    """Its lists are empty once they were cleared."""

    def __init__(self) -> None:
        super().__init__(PX4_HOLD, 0)
        self.cleared: list[int] = []

    def answers_to(self, message: Any) -> list[Any]:
        kind = message.get_type()
        if kind == "MISSION_CLEAR_ALL":
            self.cleared.append(message.mission_type)
            return [mavlink.MAVLink_mission_ack_message(*CLIENT, 0, message.mission_type)]
        if kind == "MISSION_REQUEST_LIST" and message.mission_type in self.cleared:
            return [mavlink.MAVLink_mission_count_message(*CLIENT, 0, message.mission_type)]
        return super().answers_to(message)


@pytest.mark.parametrize("why", ["late", "without control", "leaving"])
def test_lists_that_have_begun_to_be_replaced_are_all_replaced(why: str) -> None:
    """One list of another plan beside the others may be worse than either plan (R5.4, R16.10)."""
    bench = Clearing()
    out = bench.start(1, ClearPlan(), deadline_ms=1000)
    while out:
        writes = [one for one in out if isinstance(one, Transmit) and (one.not_after_ms or 9000) >= bench.now_ms]
        answers = [answer for one in writes for answer in bench.answers_to(one.message)]
        for one in transmitted(writes):
            bench.executor.on_transmitted(one.ref, bench.now_ms)
        if bench.cleared and why == "late":
            bench.now_ms = 2000
        elif bench.cleared and why == "without control":
            bench.executor.permit.has_control = lambda _: False
        elif bench.cleared:
            bench.executor.permit.is_leaving = True
        last, out = out, bench.hear(*map(from_autopilot, answers))
    assert bench.cleared == [PlanList.MISSION, PlanList.FENCE, PlanList.RALLY]
    assert said(last)[-1] == (1, Word.COMPLETED, None)
