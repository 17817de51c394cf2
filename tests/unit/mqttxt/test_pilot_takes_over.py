"""A pilot's change wins: no write of ours follows it, whether or not the autopilot's acknowledgement was lost."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.protocol.commands import (
    Arm,
    Command,
    Disarm,
    Goto,
    Hold,
    Land,
    Return,
    SetCurrentItem,
    SetParameter,
    StartMission,
    Takeoff,
)
from mqttxt.protocol.messages import CommandId, Word
from tests.simulation.workbench import ARM, LAND, MODE, REPOSITION, TAKEOFF, Bench, said, set_points, written
from tests.simulation.world import ack, heartbeat, home, landed, position, transmitted
from tests.unit.mqttxt.test_mission_starts import HASH, PX4_MISSION, Planned
from tests.unit.mqttxt.test_offboard import NORTH, Flight, in_hold, in_offboard
from tests.unit.mqttxt.test_write_permit import kinds, value


def by_pilot() -> Any:
    """A heartbeat in PX4's mode POSITION."""
    return heartbeat(armed=True, main=3, sub=0)


@pytest.mark.parametrize(
    ("undone", "words"),
    [(True, [(1, Word.UNCONFIRMED, "no_ack")]), (False, [(1, Word.ACCEPTED, None), (1, Word.COMPLETED, None)])],
)
def test_an_arm_that_has_shown_without_its_acknowledgement_is_not_written_again(undone: bool, words: Any) -> None:
    bench = Bench(heartbeat(), home(), position(), landed(1))
    assert written(bench.start(1, Arm(), deadline_ms=5000)) == [ARM]
    bench.until(300)
    bench.hear(heartbeat(armed=True))
    bench.until(400)
    bench.hear(heartbeat(armed=not undone))  # or the pilot disarms
    out = bench.until(4000)
    assert written(out) == []
    assert said(out) == words


@pytest.mark.parametrize(
    ("command", "armed", "at_ms"), [(Arm(), False, 300), (Arm(), True, 100), (Disarm(), False, 300)]
)
def test_what_may_not_have_arrived_is_written_again(command: Command, armed: bool, at_ms: int) -> None:
    """A heartbeat that comes at once may be from before the write; and to disarm twice does no harm."""
    bench = Bench(heartbeat(armed=isinstance(command, Disarm)), home(), position(), landed(1))
    bench.start(1, command, deadline_ms=5000)
    bench.until(at_ms)
    bench.hear(heartbeat(armed=armed))
    assert written(bench.until(600)) == [ARM]


def test_a_pilot_takes_an_offboard_flight_whose_acknowledgement_was_lost() -> None:
    flight = Flight()
    assert written([*flight.start(1, NORTH, deadline_ms=5000), *flight.fly_until(500)]) == [MODE]
    flight.hear(in_offboard())
    flight.fly_until(800)
    flight.hear(by_pilot())
    out = flight.fly_until(6000)
    assert written(out) == []
    assert len(set_points(out)) <= 1
    assert said(out) == [(1, Word.FAILED, "mode_changed")]


def test_a_landing_whose_acknowledgement_was_lost_goes_on_behind_offboards_end() -> None:
    flight = Flight().engage()
    flight.fly_until(8500)
    assert written(flight.start(2, Land(), deadline_ms=13_500)) == [LAND]
    out: list[Any] = []
    for second in (9, 10, 11, 12):
        out += flight.fly_until(second * 1000 + 450)
        out += flight.hear(heartbeat(armed=True, main=4, sub=6))  # PX4 lands
    assert MODE not in written(out)
    assert (1, Word.COMPLETED, None) not in said(out)


def test_hold_is_not_commanded_against_a_pilot_while_another_hold_is_unanswered() -> None:
    flight = Flight().engage()
    flight.fly_until(8500)
    flight.start(2, Hold(), deadline_ms=9000)
    flight.fly_until(9200)
    flight.hear(by_pilot())
    assert MODE not in written(flight.fly_until(13_000))


def test_a_mission_that_waits_for_its_list_is_not_started_behind_a_pilot() -> None:
    bench = Bench(heartbeat(armed=True), home(), position(20.0), landed(2))
    bench.start(1, StartMission(bytes(16)), deadline_ms=30_000)
    bench.until(3000)
    bench.hear(by_pilot())
    out = bench.until(8000)
    assert MODE not in written(out)
    assert said(out) == [(1, Word.DENIED, "mode_changed")]


def test_offboard_that_primes_does_not_begin_behind_a_pilot() -> None:
    flight = Flight()
    flight.start(1, NORTH, deadline_ms=5000)
    flight.fly_until(200)
    flight.hear(by_pilot())
    out = flight.fly_until(1000)
    assert written(out) == []
    assert said(out) == [(1, Word.DENIED, "mode_changed")]


def test_offboard_begins_behind_a_takeoff_that_the_autopilot_ends_in_hold() -> None:
    flight = Flight()
    flight.hear(heartbeat(armed=True, main=4, sub=2))
    flight.start(1, NORTH, deadline_ms=5000)
    flight.fly_until(200)
    flight.hear(in_hold())
    assert written(flight.fly_until(900)) == [MODE]


def test_a_goto_that_waits_for_its_number_is_not_written_behind_a_pilot() -> None:
    bench = Bench(heartbeat(armed=True), home(), position(20.0), landed(2))
    bench.start(1, Goto(47.4, 8.5, 10.0), deadline_ms=10_000)
    bench.until(3200)  # never acknowledged: the number rests
    bench.hear(landed(2))
    bench.start(2, Goto(47.4, 8.5, 10.0), deadline_ms=10_000)
    bench.until(3600)
    bench.hear(landed(2), by_pilot())
    out = bench.until(9000)
    assert REPOSITION not in written(out)
    assert (2, Word.DENIED, "mode_changed") in said(out)


def in_mission() -> Any:
    return heartbeat(armed=True, main=4, sub=4)


@pytest.mark.parametrize("until_ms", [700, 2600])
def test_a_mode_of_a_command_whose_acknowledgement_was_lost_is_not_a_pilots(
    until_ms: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(in_hold(), home(), position(20.0), landed(2))
    monkeypatch.setattr(bench.executor.plans, "preparing", lambda *_: None)
    bench.start(1, StartMission(bytes(16)), deadline_ms=5000)
    bench.until(until_ms)
    out = bench.start(2, Return(), deadline_ms=until_ms + 5000)
    for second in range(3, 8):
        out += [*bench.until(1000 * second), *bench.hear(in_mission())]
    assert MODE in written(out)
    assert (2, Word.DENIED, "mode_changed") not in said(out)


def test_a_hold_is_written_in_any_mode() -> None:
    bench = Bench(in_hold(), home(), position(20.0), landed(2))
    bench.start(1, Hold(), deadline_ms=7000)
    bench.executor.on_refused(CommandId(1, 1), False, 0)  # the link took nothing
    bench.hear(by_pilot())
    assert REPOSITION in written(bench.until(300))


@pytest.mark.parametrize("command", [Hold(), Land(), Return()])
@pytest.mark.parametrize("is_acknowledged", [True, False])
def test_what_ends_the_own_takeoff_is_written_again_where_the_write_was_lost(
    command: Command, is_acknowledged: bool
) -> None:
    bench = Bench(in_hold(), home(), position(), landed(1))
    bench.start(1, Takeoff(20.0), deadline_ms=5000)
    if is_acknowledged:
        bench.hear(ack(TAKEOFF))
    bench.until(100)
    bench.start(2, command, deadline_ms=5100)
    out = [*bench.until(300), *bench.hear(heartbeat(armed=True, main=4, sub=2))]
    for ms in range(500, 4001, 500):
        out += [*bench.until(ms), *bench.hear(heartbeat(armed=True, main=4, sub=2), landed(3), position(ms / 200))]
    assert [number for number in written(out) if number != TAKEOFF]


def test_nothing_is_repeated_or_begun_after_the_process_stood_still() -> None:
    bench = Bench(in_hold(), home(), position(20.0), landed(2))
    assert written(bench.start(1, Return(), deadline_ms=9000)) == [MODE]
    bench.until(100)
    bench.executor.stood_still()  # the acknowledgement was dropped with what waited
    bench.hear(by_pilot())
    assert written(bench.until(4000)) == []
    bench.executor.stood_still()
    assert written(bench.start(2, Land(), deadline_ms=9000)) == [LAND]
    bench.hear(ack(LAND), landed(2))
    bench.executor.stood_still()
    assert written([*bench.start(3, Goto(47.4, 8.5, 10.0), deadline_ms=9000), *bench.until(5000)]) == []
    bench.hear(in_hold(), landed(2))
    assert written(bench.until(5200)) == [REPOSITION]


def test_no_item_is_set_after_the_process_stood_still_before_a_heartbeat_has_shown_the_mode() -> None:
    bench = Planned(PX4_MISSION, 0)
    out = bench.start(1, SetCurrentItem(HASH, 3))
    bench.executor.stood_still()
    out = bench.answered(out) + bench.until(bench.now_ms + 1000)
    assert "MISSION_SET_CURRENT" not in kinds(out)
    assert "MISSION_SET_CURRENT" in kinds(bench.hear(PX4_MISSION) + bench.until(bench.now_ms + 600))


class Unheard(Planned):
    """Its MISSION_CURRENT is dropped with what waited while the process stood still."""

    def answers_to(self, message: Any) -> list[Any]:
        return [] if message.get_type() == "MISSION_SET_CURRENT" else super().answers_to(message)


def test_an_item_is_not_set_again_after_the_process_stood_still() -> None:
    """A pilot may have set another one since."""
    bench = Unheard(PX4_MISSION, 0)
    out = bench.answered(bench.start(1, SetCurrentItem(HASH, 3)))
    assert kinds(out).count("MISSION_SET_CURRENT") == 1
    for one in transmitted(out):
        bench.executor.on_transmitted(one.ref, bench.now_ms)
    bench.executor.stood_still()
    out = bench.hear(PX4_MISSION) + bench.until(bench.now_ms + 10_000)
    assert "MISSION_SET_CURRENT" not in kinds(out)
    assert said(out) == [(1, Word.UNCONFIRMED, "no_ack")]


def test_an_item_that_would_be_set_too_late_is_expired() -> None:
    bench = Unheard(PX4_MISSION, 0)
    bench.answered(bench.start(1, SetCurrentItem(HASH, 3)))
    assert said(bench.executor.on_refused(CommandId(1, 1), True, bench.now_ms)) == [(1, Word.EXPIRED, None)]


def test_an_item_that_does_not_show_within_the_limit_leaves_no_partial_plan() -> None:
    bench = Unheard(PX4_MISSION, 0)
    out = bench.answered(bench.start(1, SetCurrentItem(HASH, 3), limit_ms=2000))
    for one in transmitted(out):
        bench.executor.on_transmitted(one.ref, bench.now_ms)
    assert said(bench.until(2500)) == [(1, Word.FAILED, "timeout")]


@pytest.mark.parametrize("is_written", [False, True])
def test_no_parameter_is_set_after_the_process_stood_still(is_written: bool) -> None:
    bench = Bench()
    bench.start(1, SetParameter("MPC_XY_CRUISE", 5.0))
    if not is_written:
        bench.executor.stood_still()
    out = bench.hear(value("MPC_XY_CRUISE", 3.0))
    assert ("PARAM_SET" in kinds(out)) is is_written
    for one in transmitted(out):
        bench.executor.on_transmitted(one.ref, bench.now_ms)
    if is_written:
        bench.executor.stood_still()
        bench.hear(heartbeat())
    assert "PARAM_SET" not in kinds(bench.until(bench.now_ms + 5000))
    assert ("PARAM_SET" in kinds(bench.hear(heartbeat()) + bench.until(bench.now_ms + 600))) is not is_written


def test_a_parameter_that_was_set_before_the_process_stood_still_is_read_and_keeps_no_other_one_waiting() -> None:
    """Its answer was dropped with what waited in the socket."""
    bench = Bench()
    for seq, name in enumerate(("MPC_XY_CRUISE", "MPC_TKO_SPEED"), start=1):
        bench.start(seq, SetParameter(name, 5.0), deadline_ms=5000)
    for one in transmitted(bench.hear(value("MPC_XY_CRUISE", 3.0))):
        bench.executor.on_transmitted(one.ref, bench.now_ms)
    bench.executor.stood_still()
    out = bench.hear(heartbeat()) + bench.until(1000)
    assert "PARAM_REQUEST_READ" in kinds(out)
    out = bench.hear(value("MPC_XY_CRUISE", 5.0), value("MPC_XY_CRUISE", 5.0))
    assert said(out) == [(1, Word.COMPLETED, None)]
    assert kinds(bench.hear(value("MPC_TKO_SPEED", 1.0))) == ["PARAM_SET"]


def test_a_hold_that_was_written_in_another_form_has_no_definite_no() -> None:
    bench = Bench(in_hold(), home(), position(), landed(1))
    assert written(bench.start(1, Hold(), deadline_ms=2500)) == [MODE]
    bench.until(600)
    bench.hear(in_hold(), landed(2))
    while REPOSITION not in written(bench.until(bench.now_ms + 100)):
        assert bench.now_ms < 2400
    bench.executor.on_refused(CommandId(1, 1), False, bench.now_ms)
    bench.vehicle.heartbeat_ms = bench.vehicle.heard_ms = None
    bench.now_ms = 2550
    assert said(bench.executor.tick(2550)) == [(1, Word.UNCONFIRMED, "no_ack")]
