"""A mission that was flown before is begun, resumed or read, with an autopilot that is made up (section 16)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.effects import Transmit
from mqttxt.drone.mavlink.mission_protocol import message_of
from mqttxt.protocol.commands import Command, Resume, SetCurrentItem
from mqttxt.protocol.messages import Word
from mqttxt.protocol.plans import MOST_ITEMS, PlanItem, PlanList, list_hash
from tests.simulation.plan_items import SQUARE
from tests.simulation.workbench import Bench, said, written
from tests.simulation.world import ack, from_autopilot, home, landed, position
from tests.simulation.world import heartbeat as px4_heartbeat
from tests.unit.mqttxt.test_ardupilot import GUIDED, heartbeat

HASH = list_hash(SQUARE)
CLIENT = (1, 191)
AIR, MODE, MISSION_START, AUTO = 2, 176, 300, 3
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


def test_a_mission_that_is_set_back_is_not_over() -> None:
    bench = Planned(PX4_MISSION, 0)
    bench.hear(bench.current(3), bench.reached(3))
    out = bench.begin(SetCurrentItem(HASH, 2))
    assert said(out)[-1] == (1, Word.COMPLETED, None)
    assert not bench.vehicle.mission.is_over


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
