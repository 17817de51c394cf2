"""More than one acknowledgement of a command: PX4's second of a mode change, and copies (R5.6, R5.18)."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.effects import Transmit
from mqttxt.drone.mavlink.sources import Source
from mqttxt.protocol.commands import Arm, Disarm, Goto, Hold, Offboard, Return, StartMission, Velocity
from mqttxt.protocol.messages import Word
from tests.simulation.workbench import ARM, MODE, REPOSITION, Bench, said, set_points, written
from tests.simulation.world import ack, from_autopilot, heartbeat, home, landed, position
from tests.unit.mqttxt.test_offboard import Flight

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = 0, 1, 2, 3, 4, 5
TAKEN, REJECTED_WORD = (1, Word.ACCEPTED, None), (1, Word.FAILED, "temporarily_rejected")
GROUND, AIR = 1, 2
RETURNING = {"main": 4, "sub": 5}


def flying() -> Bench:
    return Bench(heartbeat(armed=True), home(), position(10.0), landed(AIR))


def returning() -> Bench:
    """A drone in the air whose return was accepted."""
    bench = flying()
    bench.start(1, Return())
    assert said(bench.hear(ack(MODE))) == [TAKEN]
    return bench


def has_plan(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mission's start, unlike a return, waits for its number."""
    monkeypatch.setattr(bench.executor.plans, "preparing", lambda *_: None)


@pytest.mark.parametrize(
    ("result", "reason"),
    [(REJECTED, "temporarily_rejected"), (DENIED, "autopilot"), (UNSUPPORTED, "unsupported"), (FAILED, "autopilot")],
)
def test_a_return_that_is_refused_after_it_was_accepted_has_failed(result: int, reason: str) -> None:
    out = returning().refuse(ack(MODE, result))
    assert len(out) == 1, "nothing is counted as stray"
    assert said(out) == [(1, Word.FAILED, reason)]


def of_a_camera(number: int, result: int) -> Any:
    """What another component of the same system says about a command that was not for it."""
    return from_autopilot(mavlink.MAVLink_command_ack_message(number, result, 0, 0, 1, 191), component=100)


def test_another_components_refusal_is_not_the_autopilots_second_answer() -> None:
    bench = returning()
    assert bench.hear(of_a_camera(MODE, UNSUPPORTED)) == []
    assert said(bench.refuse(ack(MODE, REJECTED))) == [REJECTED_WORD]


def test_another_components_answers_do_not_free_a_number_that_rests() -> None:
    bench = flying()
    there = Goto(47.4, 8.55, 10.0)
    bench.start(1, there)
    bench.until(2600)
    assert written(bench.start(2, there)) == []
    assert bench.hear(*[of_a_camera(REPOSITION, ACCEPTED)] * 4) == []
    assert written(bench.until(3000)) == []


def test_a_second_acceptance_says_nothing_new() -> None:
    bench = returning()
    assert bench.hear(ack(MODE)) == []
    assert written(bench.start(2, Return())) == [MODE]


def test_the_second_acknowledgement_is_not_taken_for_the_next_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = returning()
    has_plan(bench, monkeypatch)
    assert written(bench.start(2, StartMission(bytes(16)))) == []
    out = bench.refuse(ack(MODE, REJECTED))
    assert (said(out), written(out)) == ([REJECTED_WORD], [MODE])
    assert said(bench.hear(ack(MODE))) == [(2, Word.ACCEPTED, None)]


def test_the_second_acknowledgement_is_not_that_of_a_return_which_does_not_wait_for_it() -> None:
    bench = returning()
    assert written(bench.start(2, Return())) == [MODE]
    assert said(bench.refuse(ack(MODE, REJECTED))) == [REJECTED_WORD]
    assert said(bench.hear(ack(MODE, source=Source.HALT)))[0] == (2, Word.ACCEPTED, None)


def test_an_autopilot_that_answers_once_bars_its_number_for_a_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """PX4 1.15."""
    bench = returning()
    has_plan(bench, monkeypatch)
    bench.start(2, StartMission(bytes(16)))
    assert written(bench.until(200)) == []
    assert written(bench.until(300)) == [MODE]
    assert said(bench.hear(ack(MODE)))[0] == (2, Word.ACCEPTED, None)


def test_of_two_copies_one_refusal_leaves_the_other() -> None:
    bench = flying()
    bench.start(1, Return())
    assert written(bench.until(500)) == [MODE]
    assert said(bench.hear(ack(MODE), ack(MODE), ack(MODE), ack(MODE, REJECTED))) == [TAKEN]


def test_two_copies_that_are_both_refused_have_failed() -> None:
    bench = flying()
    bench.start(1, Return())
    bench.until(500)
    out = bench.refuse(ack(MODE), ack(MODE, REJECTED), ack(MODE), ack(MODE, REJECTED))
    assert said(out) == [TAKEN, REJECTED_WORD]


def test_a_mode_that_a_heartbeat_has_shown_is_not_refused() -> None:
    bench = returning()
    bench.hear(heartbeat(armed=True, **RETURNING))
    assert said(bench.hear(ack(MODE, REJECTED))) == []


def test_a_hold_on_the_ground_that_is_refused_has_failed() -> None:
    bench = Bench()
    bench.start(1, Hold())
    out = bench.refuse(ack(MODE, source=Source.HALT), ack(MODE, REJECTED, source=Source.HALT))
    assert said(out) == [TAKEN, REJECTED_WORD]


def test_an_offboard_command_that_is_refused_ends_its_set_points() -> None:
    flight = Flight()
    flight.start(1, Offboard(10.0, velocity=Velocity(1.0, 0.0, 0.0)))
    flight.fly_until(500)
    assert said(flight.refuse(ack(MODE), ack(MODE, REJECTED))) == [TAKEN, REJECTED_WORD]
    out = flight.fly_until(2000)
    assert (set_points(out), written(out)) == ([], [])


def test_the_second_answer_to_a_hold_of_our_own_is_not_the_next_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    """The end of a flight by set-points, and a mission at once."""
    flight = Flight().engage()
    flight.fly_until(10_500)
    flight.hear(ack(MODE), heartbeat(armed=True))
    has_plan(flight, monkeypatch)
    assert written(flight.start(2, StartMission(bytes(16)))) == []
    assert flight.hear(ack(MODE)) == []
    assert written(flight.until(flight.now_ms + 100)) == [MODE]


def test_an_autopilot_that_answers_once_is_not_waited_for_after_several_holds_of_our_own() -> None:
    flight = Flight().engage()
    for now_ms in (10_500, 11_000, 11_500):
        assert written(flight.fly_until(now_ms)) == [MODE]
        flight.hear(ack(MODE))
    flight.fly_until(11_850)
    flight.hear(heartbeat(armed=True))
    assert written(flight.start(2, Return())) == [MODE]


def test_a_refusal_that_comes_late_is_still_the_commands() -> None:
    bench = returning()
    bench.until(1000)
    assert said(bench.refuse(ack(MODE, REJECTED))) == [REJECTED_WORD]


def test_other_numbers_are_answered_once() -> None:
    bench = flying()
    bench.start(1, Goto(47.4, 8.5, 10.0))
    bench.hear(ack(REPOSITION))
    assert [o.kind for o in bench.hear(ack(REPOSITION, REJECTED))] == ["ack_unexpected"]


def twice_written() -> Bench:
    bench = Bench()
    bench.start(1, Arm(), limit_ms=4000)
    assert written(bench.until(500)) == [ARM]
    return bench


def test_a_refusal_is_no_definite_no_while_another_copy_is_unanswered() -> None:
    bench = twice_written()
    assert said(bench.hear(ack(ARM, REJECTED))) == []
    out = bench.until(5000)
    assert written(out) == []
    assert said(out) == [(1, Word.UNCONFIRMED, "refused_once")]


def test_copies_that_are_all_refused_are_a_definite_no() -> None:
    bench = twice_written()
    assert said(bench.refuse(ack(ARM, REJECTED), ack(ARM, REJECTED))) == [(1, Word.DENIED, "temporarily_rejected")]


def px4_text(*parts: str) -> list[Any]:
    """A text as PX4 sends it: parts of 50 characters, and a tab at the end."""
    severity = mavlink.MAV_SEVERITY_CRITICAL
    return [
        from_autopilot(mavlink.MAVLink_statustext_message(severity, part.encode(), 7 if len(parts) > 1 else 0, number))
        for number, part in enumerate(parts)
    ]


@pytest.mark.parametrize(
    ("parts", "text"),
    [
        (
            ("Arming denied: Resolve system health failures firs", "t\t"),
            "Arming denied: Resolve system health failures first",
        ),
        (("Disarming denied: not landed\t",), "Disarming denied: not landed"),
    ],
)
def test_a_refusal_quotes_the_text_behind_it_once_it_is_whole(parts: tuple[str, ...], text: str) -> None:
    """PX4 sends it within a millisecond."""
    bench = Bench()
    bench.start(1, Arm())
    assert said(bench.hear(ack(ARM, REJECTED), *px4_text(*parts)[:-1])) == []
    assert said(bench.hear(px4_text(*parts)[-1])) == [(1, Word.DENIED, f"temporarily_rejected: {text}")]
    assert bench.until(1000) == []


def test_a_text_explains_the_newest_refusal_alone() -> None:
    bench = flying()
    bench.start(1, Goto(47.4, 8.5, 20))
    bench.start(2, Disarm())
    assert said(bench.hear(ack(REPOSITION, REJECTED))) == []
    assert said(bench.hear(ack(ARM, REJECTED))) == [(1, Word.DENIED, "temporarily_rejected")]
    text = px4_text("Disarming denied: not landed\t")
    assert said(bench.hear(*text)) == [(2, Word.DENIED, "temporarily_rejected: Disarming denied: not landed")]


def test_what_nobody_knows_waits_for_no_text() -> None:
    """A hold of the ground is unanswered, and refused in the form of the air."""
    bench = Bench(heartbeat(armed=True), home(), position(0.0), landed(1))
    bench.start(1, Hold())
    bench.hear(landed(AIR), position(5.0))
    (written_as,) = [one.source for one in bench.until(600) if isinstance(one, Transmit)]
    assert said(bench.hear(ack(REPOSITION, REJECTED, source=written_as))) == [(1, Word.UNCONFIRMED, "no_ack")]


def test_a_refusal_whose_text_never_ends_is_not_waited_for_longer() -> None:
    bench = Bench()
    bench.start(1, Arm())
    assert said(bench.refuse(ack(ARM, REJECTED), px4_text("A" * 50, "B")[0])) == [
        (1, Word.DENIED, "temporarily_rejected")
    ]


@pytest.mark.parametrize("refusal", [REJECTED, FAILED])
def test_a_copy_that_was_accepted_goes_before_one_that_was_refused(refusal: int) -> None:
    bench = twice_written()
    assert said(bench.hear(ack(ARM, refusal))) == []
    assert said(bench.hear(ack(ARM), heartbeat(armed=True))) == [TAKEN, (1, Word.COMPLETED, None)]


@pytest.mark.parametrize("refusal", [REJECTED, DENIED, FAILED])
def test_a_copy_in_progress_goes_before_one_that_was_refused(refusal: int) -> None:
    bench = twice_written()
    assert said(bench.hear(ack(ARM, IN_PROGRESS, 10), ack(ARM, refusal))) == [(1, Word.IN_PROGRESS, None)]
    assert said(bench.hear(ack(ARM), heartbeat(armed=True))) == [TAKEN, (1, Word.COMPLETED, None)]


def test_copies_in_progress_that_are_all_refused_have_failed() -> None:
    bench = twice_written()
    out = bench.refuse(ack(ARM, REJECTED), ack(ARM, IN_PROGRESS, 10), ack(ARM, REJECTED))
    assert said(out) == [(1, Word.IN_PROGRESS, None), REJECTED_WORD]


def test_a_copy_in_progress_of_which_nothing_more_is_heard_may_have_been_carried_out() -> None:
    bench = twice_written()
    bench.hear(ack(ARM, IN_PROGRESS, 10), ack(ARM, REJECTED))
    assert said(bench.until(4000)) == [(1, Word.UNCONFIRMED, "refused_once")]


def test_past_its_limit_a_command_has_failed_though_a_copy_of_it_was_refused() -> None:
    bench = twice_written()
    bench.hear(ack(ARM, REJECTED), ack(ARM))
    assert said(bench.until(4000)) == [(1, Word.FAILED, "timeout")]


def test_a_copy_that_failed_makes_no_definite_no_of_the_others_refusal() -> None:
    bench = twice_written()
    bench.refuse(ack(ARM, FAILED))
    assert said(bench.refuse(ack(ARM, DENIED))) == [(1, Word.FAILED, "autopilot")]
