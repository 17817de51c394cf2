"""The executor: one open command of a MAV_CMD, writes within the deadline, one last word (section 5)."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.effects import Log
from mqttxt.drone.effects import Transmit
from mqttxt.drone.mavlink.plans import CommandPlan
from mqttxt.drone.mavlink.px4 import Px4
from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.drone.runs import Said
from mqttxt.protocol.commands import Arm, Command, Disarm, Goto, Land, Return, Takeoff
from mqttxt.protocol.messages import CommandId, Word
from tests.simulation.workbench import ARM, LAND, MODE, TAKEOFF, Bench, said, written
from tests.simulation.world import ack, heartbeat, home, landed, position


def begun(command: Command, **how: Any) -> Bench:
    """A bench whose command 1 was started."""
    bench = Bench()
    bench.start(1, command, **how)
    return bench


def test_completed_needs_the_effect_newer_than_the_acknowledgement() -> None:
    bench = Bench(heartbeat(armed=True), home(), position(), landed(1))
    assert written(bench.start(1, Arm())) == [ARM]
    assert said(bench.hear(heartbeat(armed=True))) == []
    assert said(bench.hear(ack(ARM))) == [(1, Word.ACCEPTED, None)]
    assert said(bench.until(500)) == []
    assert said(bench.hear(heartbeat(armed=True))) == [(1, Word.COMPLETED, None)]


def test_every_write_carries_the_deadline() -> None:
    bench = Bench()
    out = bench.start(1, Arm(), deadline_ms=700) + bench.until(5000)
    transmits = [o for o in out if isinstance(o, Transmit)]
    assert len(transmits) == 2
    assert {t.not_after_ms for t in transmits} == {700}


def test_without_an_answer_it_is_repeated_and_then_unconfirmed() -> None:
    bench = Bench()
    out = bench.start(1, Arm()) + bench.until(5000)
    assert written(out) == [ARM] * 4
    assert said(out) == [(1, Word.UNCONFIRMED, "no_ack")]


def test_a_write_that_was_held_up_is_repeated_half_a_second_after_it() -> None:
    """As by a journal on a slow disk: the answer to the first copy had no time to come."""
    bench = begun(Arm())
    bench.executor.on_transmitted(CommandId(1, 1), 400)
    assert written(bench.until(800)) == []
    assert written(bench.until(900)) == [ARM]


def test_after_a_time_out_the_number_is_barred_for_three_seconds() -> None:
    bench = begun(Arm())
    bench.until(2500)
    assert written(bench.start(2, Arm())) == []
    assert written(bench.until(5400)) == []
    assert written(bench.until(5600)) == [ARM]


def test_a_late_acknowledgement_is_discarded_and_never_credited_to_the_next() -> None:
    bench = begun(Arm())
    bench.until(2500)
    bench.start(2, Disarm())
    out = bench.hear(ack(ARM))
    assert said(out) == []
    assert [o.kind for o in out if isinstance(o, Log)] == ["ack_discarded"]
    assert bench.until(2700) == []


def test_only_one_command_of_a_number_is_open() -> None:
    bench = begun(Arm())
    assert written(bench.start(2, Arm())) == []
    assert said(bench.hear(ack(ARM))) == [(1, Word.ACCEPTED, None)]
    out = bench.until(200)
    assert written(out) == [ARM]
    assert said(bench.hear(ack(ARM))) == [(2, Word.ACCEPTED, None), (1, Word.SUPERSEDED, None)]


def test_waiting_past_the_deadline_is_expired_and_never_written() -> None:
    bench = begun(Arm())
    out = bench.start(2, Arm(), deadline_ms=300) + bench.until(400)
    assert said(out) == [(2, Word.EXPIRED, None)]
    assert written(out) == []


def test_a_write_refused_for_its_lateness_is_expired() -> None:
    bench = begun(Arm(), deadline_ms=100)
    assert said(bench.executor.on_refused(CommandId(1, 1), True, 150)) == [(1, Word.EXPIRED, None)]


def test_a_refused_retransmission_is_not_expired_for_the_first_was_written() -> None:
    bench = begun(Arm())
    bench.until(500)
    assert bench.executor.on_refused(CommandId(1, 1), True, 550) == []
    assert said(bench.hear(ack(ARM))) == [(1, Word.ACCEPTED, None)]


def test_a_link_that_takes_nothing_is_tried_again() -> None:
    bench = begun(Arm())
    assert bench.executor.on_refused(CommandId(1, 1), False, 0) == []
    assert written(bench.until(100)) == [ARM]


def test_lateness_after_the_write_is_told() -> None:
    bench = begun(Arm(), deadline_ms=100)
    bench.executor.on_transmitted(CommandId(1, 1), 130)
    accepted, completed = [*bench.hear(ack(ARM)), *bench.hear(heartbeat(armed=True))]
    assert accepted.late_ms == completed.late_ms == 30


def test_progress_ends_retransmission_and_is_told_when_it_has_changed_and_255_is_unknown() -> None:
    bench = begun(Arm())
    out = []
    for percent in (255, 255, 10, 10, 55, 255):
        out += [*bench.hear(ack(ARM, 5, percent)), *bench.until(bench.now_ms + 1000)]
    assert [o.percent for o in out] == [None, 10, 55, None]


def test_of_much_progress_the_newest_is_told_once_a_second() -> None:
    bench = begun(Arm(), limit_ms=10_000)
    told = []
    for now_ms in range(0, 5000, 10):
        bench.now_ms = now_ms
        told += [(now_ms, o.percent) for o in bench.hear(ack(ARM, 5, now_ms // 50)) if isinstance(o, Said)]
    assert told == [(0, 0), (1000, 20), (2000, 40), (3000, 60), (4000, 80)]
    assert [o.percent for o in bench.until(6000) if isinstance(o, Said)] == [99]


@pytest.mark.parametrize("result", [1, 2, 3, 4, 9, 77])
def test_a_refusal_after_progress_is_no_definite_no(result: int) -> None:
    bench = begun(Arm())
    bench.hear(ack(ARM, 5, 50))
    ((_, word, reason),) = said(bench.refuse(ack(ARM, result)))
    assert (word, bool(reason)) == (Word.FAILED, True)


@pytest.mark.parametrize(
    ("result", "word", "reason"),
    [
        (1, Word.DENIED, "temporarily_rejected"),
        (2, Word.DENIED, "autopilot"),
        (3, Word.UNSUPPORTED, None),
        (4, Word.FAILED, "autopilot"),
        (6, Word.FAILED, "cancelled"),
        (7, Word.DENIED, "command_long_only"),
        (8, Word.DENIED, "command_int_only"),
        (9, Word.DENIED, "command_unsupported_mav_frame"),
        (10, Word.DENIED, "not_in_control_of_autopilot"),
        (11, Word.FAILED, "mav_result_11"),
    ],
)
def test_the_autopilots_refusal_is_the_last_word_and_has_a_name(result: int, word: Word, reason: str | None) -> None:
    bench = begun(Arm())
    assert said(bench.refuse(ack(ARM, result))) == [(1, word, reason)]
    assert bench.until(3000) == []


def test_the_acknowledgement_after_progress_decides() -> None:
    accepted, refused = Bench(), Bench()
    for bench in (accepted, refused):
        bench.start(1, Arm())
        bench.hear(ack(ARM, 5, 50))
        bench.until(6000)
    out = accepted.hear(ack(ARM), heartbeat(armed=True))
    assert said(out) == [(1, Word.ACCEPTED, None), (1, Word.COMPLETED, None)]
    assert said(refused.refuse(ack(ARM, 4))) == [(1, Word.FAILED, "autopilot")]


def test_progress_without_end_fails_at_the_limit_and_the_number_rests() -> None:
    bench = begun(Arm(), limit_ms=4000)
    bench.hear(ack(ARM, 5, 40))
    assert said(bench.until(4000)) == [(1, Word.FAILED, "timeout")]
    assert written(bench.start(2, Arm())) == []
    assert [o.kind for o in bench.hear(ack(ARM)) if isinstance(o, Log)] == ["ack_discarded"]
    assert written(bench.until(4100)) == [ARM]


def test_a_command_in_progress_supersedes_and_is_superseded() -> None:
    bench = begun(Takeoff(altitude_m=10))
    bench.hear(ack(TAKEOFF, 5, 20))
    bench.start(2, Land())
    assert said(bench.hear(ack(LAND, 5, 255))) == [(2, Word.IN_PROGRESS, None), (1, Word.SUPERSEDED, None)]
    assert said(bench.hear(ack(TAKEOFF))) == []
    assert said(bench.hear(ack(LAND))) == [(2, Word.ACCEPTED, None)]


def test_past_its_limit_a_command_has_failed() -> None:
    bench = begun(Land(), limit_ms=2000)
    bench.hear(ack(LAND))
    assert said(bench.until(2000)) == [(1, Word.FAILED, "timeout")]


def test_past_its_limit_without_the_autopilot_nobody_knows() -> None:
    bench = begun(Land(), limit_ms=5000)
    bench.hear(ack(LAND))
    assert said(bench.executor.tick(5000)) == [(1, Word.UNCONFIRMED, "autopilot_lost")]


def test_without_the_autopilots_heartbeat_nothing_starts() -> None:
    bench = Bench()
    bench.now_ms = 3001
    assert said(bench.start(1, Arm())) == [(1, Word.DENIED, "no_autopilot")]


@pytest.mark.parametrize("command", [Takeoff(altitude_m=10), Goto(47.0, 8.0, 10.0)])
def test_altitudes_need_home(command: Command) -> None:
    assert said(Bench(heartbeat(armed=True), landed(2)).start(1, command)) == [(1, Word.DENIED, "home_unknown")]


@pytest.mark.parametrize(
    ("command", "number", "own", "pilots"),
    [(Land(), LAND, (4, 6), (3, 0)), (Land(), LAND, (4, 6), (4, 5)), (Return(), MODE, (4, 5), (4, 6))],
)
def test_a_pilots_mode_ends_a_running_command(
    command: Command, number: int, own: tuple[int, int], pilots: tuple[int, int]
) -> None:
    bench = begun(command)
    bench.hear(ack(number), heartbeat(armed=True, main=own[0], sub=own[1]))
    over = heartbeat(armed=True, main=pilots[0], sub=pilots[1])
    assert said(bench.hear(over)) == [(1, Word.FAILED, "mode_changed")]


def test_a_mode_that_showed_before_the_acknowledgement_was_entered() -> None:
    bench = begun(Land())
    bench.hear(heartbeat(armed=True, main=4, sub=6), ack(LAND))
    assert said(bench.hear(heartbeat(armed=True, main=4, sub=5))) == [(1, Word.FAILED, "mode_changed")]


def test_a_mode_from_before_the_write_was_not_entered_by_it() -> None:
    bench = Bench()
    bench.hear(heartbeat(armed=True, main=4, sub=6))
    bench.start(1, Land())
    bench.hear(ack(LAND))
    assert said(bench.hear(heartbeat(armed=True, main=4, sub=5))) == []


@pytest.mark.parametrize(("command", "number", "own"), [(Land(), LAND, (4, 6)), (Return(), MODE, (4, 5))])
def test_a_px4_that_disarms_and_holds_before_it_says_that_it_landed_has_landed(
    command: Command, number: int, own: tuple[int, int]
) -> None:
    bench = begun(command)
    bench.hear(ack(number), landed(4), heartbeat(armed=True, main=own[0], sub=own[1]))
    assert said(bench.hear(heartbeat(armed=False, main=4, sub=3))) == []
    assert said(bench.hear(landed(1))) == [(1, Word.COMPLETED, None)]


def test_a_drone_whose_motors_were_stopped_in_the_air_has_not_landed() -> None:
    bench = begun(Land())
    bench.hear(ack(LAND), landed(4), heartbeat(armed=True, main=4, sub=6))
    assert said(bench.hear(heartbeat(armed=False, main=4, sub=3))) == []
    assert said(bench.until(3100)) == [(1, Word.FAILED, "mode_changed")]


PILOTS_POSITION = heartbeat(armed=True, main=3)


def test_a_pilots_mode_before_the_commands_own_has_shown_ends_it_too() -> None:
    bench = begun(Land())
    bench.hear(ack(LAND))
    bench.until(250)
    assert said(bench.hear(PILOTS_POSITION)) == [(1, Word.FAILED, "mode_changed")]


def test_a_heartbeat_from_within_the_change_of_mode_says_nothing_of_a_pilot() -> None:
    bench = begun(Land())
    bench.hear(ack(LAND), PILOTS_POSITION)
    assert bench.until(1100) == []
    assert bench.hear(heartbeat(armed=True, main=4, sub=6)) == []
    assert said(bench.hear(PILOTS_POSITION)) == [(1, Word.FAILED, "mode_changed")]


def test_a_mode_from_between_write_and_acknowledgement_may_be_the_one_before() -> None:
    bench = begun(Land())
    bench.hear(PILOTS_POSITION, ack(LAND))
    bench.until(1000)
    assert bench.hear(PILOTS_POSITION) == []


def test_a_mode_that_a_superseded_command_had_asked_for_is_no_pilots() -> None:
    bench = begun(Land())
    bench.hear(ack(LAND))
    bench.start(2, Return())
    assert said(bench.hear(ack(MODE))) == [(2, Word.ACCEPTED, None), (1, Word.SUPERSEDED, None)]
    bench.until(1000)
    assert bench.hear(heartbeat(armed=True, main=4, sub=6)) == []
    bench.hear(heartbeat(armed=True, main=4, sub=5))
    assert said(bench.hear(heartbeat(armed=True, main=4, sub=6))) == [(2, Word.FAILED, "mode_changed")]


@pytest.mark.parametrize(
    "shown",
    [
        [PILOTS_POSITION],
        [heartbeat(armed=True, main=4, sub=6), PILOTS_POSITION],
        [heartbeat(armed=True, main=4, sub=6), heartbeat(armed=True, main=4, sub=3)],
    ],
    ids=["before its own", "after its own", "back to the one before"],
)
def test_a_command_without_an_acknowledgement_is_not_written_over_a_pilot(shown: list[Any]) -> None:
    bench = Bench()
    bench.hear(heartbeat(armed=True, main=4, sub=3))
    bench.start(1, Land())
    for one in shown:
        bench.hear(one)
        bench.until(bench.now_ms + 100)
    out = bench.until(3000)
    assert not [effect for effect in out if isinstance(effect, Transmit)]
    assert said(out) == [(1, Word.UNCONFIRMED, "no_ack")]


def test_a_command_without_an_acknowledgement_is_written_again_in_its_own_mode() -> None:
    bench = Bench()
    bench.hear(heartbeat(armed=True, main=4, sub=3))
    bench.start(1, Land())
    bench.hear(heartbeat(armed=True, main=4, sub=6))
    assert [effect for effect in bench.until(600) if isinstance(effect, Transmit)]


def test_a_mode_that_is_still_changing_has_three_seconds() -> None:
    bench = begun(Land())
    bench.hear(ack(LAND), heartbeat(armed=True, main=4, sub=3))
    bench.until(3000)
    assert said(bench.hear(heartbeat(armed=True, main=4, sub=3))) == []
    bench.now_ms = 3100
    assert said(bench.hear(heartbeat(armed=True, main=4, sub=3))) == [(1, Word.FAILED, "mode_changed")]


def test_a_newer_flight_command_supersedes_the_running_one() -> None:
    bench = begun(Takeoff(altitude_m=10))
    bench.hear(ack(TAKEOFF))
    assert written(bench.start(2, Land())) == [LAND]
    accepted, superseded = bench.hear(ack(LAND))
    assert (accepted.id.seq, accepted.word) == (2, Word.ACCEPTED)
    assert (superseded.id.seq, superseded.word, superseded.by) == (1, Word.SUPERSEDED, CommandId(1, 2))


def test_an_older_command_is_never_said_again_after_a_newer_one() -> None:
    """A takeoff whose acknowledgement was lost must not be repeated while the drone lands."""
    bench = begun(Takeoff(altitude_m=10))
    bench.until(200)
    bench.start(2, Land())
    bench.hear(ack(LAND))
    assert written(bench.until(5000)) == []


def test_an_acknowledged_command_supersedes_an_older_one_that_nobody_acknowledged() -> None:
    """The older one's late acknowledgement is nobody's, and does not end the newer."""
    bench = begun(Takeoff(altitude_m=10))
    bench.start(2, Land())
    assert said(bench.hear(ack(LAND))) == [(2, Word.ACCEPTED, None), (1, Word.SUPERSEDED, None)]
    assert said(bench.hear(ack(TAKEOFF))) == []
    assert said(bench.hear(landed(1), heartbeat(main=4, sub=6))) == [(2, Word.COMPLETED, None)]


def test_an_older_command_is_not_repeated_even_when_the_newer_was_denied() -> None:
    bench = begun(Takeoff(altitude_m=10))
    bench.start(2, Land())
    bench.refuse(ack(LAND, 2))
    out = bench.until(5000)
    assert written(out) == []
    assert said(out) == [(1, Word.UNCONFIRMED, "no_ack")]


def test_a_waiting_command_is_superseded_by_the_next_of_its_kind() -> None:
    bench = begun(Takeoff(altitude_m=10))
    bench.start(2, Takeoff(altitude_m=20))
    (superseded, transmit) = bench.start(3, Land())
    assert (superseded.id.seq, superseded.word, superseded.by) == (2, Word.SUPERSEDED, CommandId(1, 3))
    assert transmit.message.command == LAND


def test_a_takeoff_is_completed_when_airborne_at_its_altitude() -> None:
    bench = begun(Takeoff(altitude_m=10))
    bench.hear(ack(TAKEOFF), heartbeat(armed=True, main=4, sub=2))
    assert said(bench.hear(landed(2), position(9.4))) == []
    assert said(bench.hear(landed(2), position(9.6))) == [(1, Word.COMPLETED, None)]


def test_a_takeoff_that_is_disarmed_has_failed() -> None:
    bench = begun(Takeoff(altitude_m=10))
    bench.hear(ack(TAKEOFF), heartbeat(armed=True, main=4, sub=2))
    assert said(bench.hear(heartbeat(armed=False, main=4, sub=2))) == [(1, Word.FAILED, "disarmed")]


def test_a_command_is_planned_once_to_be_written_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    planned: list[Command] = []
    plan = Px4.plan

    def noted(self: Px4, command: Command, vehicle: Vehicle, now_ms: int) -> CommandPlan:
        planned.append(command)
        return plan(self, command, vehicle, now_ms)

    monkeypatch.setattr(Px4, "plan", noted)
    assert written(Bench().start(1, Land())) == [LAND]
    assert planned == [Land()]


def test_a_command_that_comes_too_late_takes_no_place() -> None:
    bench = begun(Takeoff(altitude_m=10))
    bench.now_ms = 500
    assert said(bench.start(2, Land(), deadline_ms=400)) == [(2, Word.EXPIRED, None)]
    assert written(bench.until(600)) == [TAKEOFF]


def test_an_acknowledgement_that_nobody_asked_for_is_counted() -> None:
    bench = Bench()
    assert [o.kind for o in bench.hear(ack(ARM))] == ["ack_unexpected"]
    assert bench.hear(ack(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)) == []
