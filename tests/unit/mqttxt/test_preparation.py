"""The mode that comes before a command, and a pilot who changes it (R5.19, R5.23)."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.protocol.commands import Arm, Command, Disarm, Hold, Land, Return, Takeoff
from mqttxt.protocol.messages import Word
from tests.simulation.workbench import ARM, MODE, TAKEOFF, Bench, said, written
from tests.simulation.world import ack, home, landed, position
from tests.simulation.world import heartbeat as px4_heartbeat
from tests.unit.mqttxt.test_ardupilot import BRAKE, GUIDED, LAND, LOITER, STABILIZE, heartbeat

GROUND, AIR = 1, 2
LANDING = 21
REFUSED = 4
CLIMB = Takeoff(10.0)
PREPARED: list[tuple[Command, int, bool, int]] = [(CLIMB, LOITER, True, TAKEOFF), (Arm(), LAND, False, ARM)]


class Grounded(Bench):
    """An autopilot that goes on saying that it is on the ground."""

    def until(self, now_ms: int, step_ms: int = 100) -> list[Any]:
        out: list[Any] = []
        while self.now_ms < now_ms:
            self.vehicle.update(landed(GROUND), self.now_ms)
            out += super().until(self.now_ms + step_ms, step_ms)
        return out


def prepared(command: Command, mode: int, armed: bool) -> Bench:
    """A drone on the ground whose mode is changed before a command."""
    bench = Grounded(heartbeat(mode, armed), home(), position(), landed(GROUND))
    assert written(bench.start(1, command)) == [MODE]
    return bench


def later(bench: Bench, milliseconds: int, *told: Any) -> list[Any]:
    """Hear messages and let time pass."""
    return bench.hear(*told) + bench.until(bench.now_ms + milliseconds)


@pytest.mark.parametrize("mode", [STABILIZE, BRAKE])
@pytest.mark.parametrize("answers", [[ack(MODE)], []])
def test_a_pilot_who_changes_the_mode_wins(mode: int, answers: list[Any]) -> None:
    bench = prepared(CLIMB, LOITER, armed=True)
    out = later(bench, 100, *answers, heartbeat(mode, armed=True))
    assert said(out) == [(1, Word.FAILED, "mode_changed")]
    assert written(out + bench.until(5000)) == []


@pytest.mark.parametrize("mode", [LOITER, LAND])
def test_a_pilot_who_changes_the_mode_back_before_the_command_is_said_wins(mode: int) -> None:
    bench = Bench(heartbeat(GUIDED, armed=True), home(), position(), landed(GROUND))
    bench.start(1, CLIMB)
    bench.until(2500)  # unanswered, so that the number rests
    bench.hear(heartbeat(LOITER, armed=True))
    assert written(bench.start(2, CLIMB)) == [MODE]
    assert written(later(bench, 100, heartbeat(GUIDED, armed=True))) == []
    out = later(bench, 100, heartbeat(mode, armed=True))
    assert said(out) == [(2, Word.FAILED, "mode_changed")]
    assert written(out + bench.until(10_000)) == []


@pytest.mark.parametrize(("command", "mode", "armed", "number"), PREPARED)
def test_a_mode_that_was_accepted_is_not_commanded_again(command: Command, mode: int, armed: bool, number: int) -> None:
    """A pilot may have changed it back before a heartbeat showed it."""
    bench = prepared(command, mode, armed)
    out = bench.hear(ack(MODE))
    for _ in range(6):
        out += later(bench, 600, heartbeat(mode, armed))
    assert written(out) == []
    assert said(out) == [(1, Word.FAILED, "mode_changed")]


@pytest.mark.parametrize(("command", "mode", "armed", "number"), PREPARED)
def test_without_an_answer_it_is_commanded_again_and_no_definite_no_is_said(
    command: Command, mode: int, armed: bool, number: int
) -> None:
    bench = prepared(command, mode, armed)
    out = bench.until(4000)
    assert written(out) == [MODE] * 6
    assert said(out) == [(1, Word.FAILED, "wrong_mode")]


@pytest.mark.parametrize(("command", "mode", "armed", "number"), PREPARED)
def test_a_mode_that_was_refused_each_time_changed_nothing(
    command: Command, mode: int, armed: bool, number: int
) -> None:
    bench = prepared(command, mode, armed)
    out = bench.hear(ack(MODE, REFUSED))
    while not said(out):
        asked = bench.until(bench.now_ms + 100)
        out += asked + (bench.hear(ack(MODE, REFUSED)) if written(asked) else [])
    assert said(out) == [(1, Word.DENIED, "wrong_mode")]


@pytest.mark.parametrize(("command", "mode", "armed", "number"), PREPARED)
def test_a_refusal_behind_a_mode_that_was_changed_is_no_definite_no(
    command: Command, mode: int, armed: bool, number: int
) -> None:
    bench = prepared(command, mode, armed)
    assert written(later(bench, 100, ack(MODE), heartbeat(GUIDED, armed))) == [number]
    bench.hear(ack(number, REFUSED))
    assert said(bench.until(bench.now_ms + 200)) == [(1, Word.FAILED, "autopilot")]


def test_past_the_deadline_it_has_failed_where_the_mode_was_changed() -> None:
    bench = Bench(heartbeat(LOITER, armed=True), home(), position(), landed(GROUND))
    bench.start(1, CLIMB, deadline_ms=700)
    assert said(bench.until(1000)) == [(1, Word.FAILED, "expired")]


def test_a_drone_that_is_disarmed_meanwhile_has_failed_where_the_mode_was_changed() -> None:
    bench = prepared(CLIMB, LOITER, armed=True)
    assert said(later(bench, 100, ack(MODE), heartbeat(GUIDED, armed=False))) == [(1, Word.FAILED, "disarmed")]


def test_a_takeoff_is_not_repeated_in_a_mode_that_a_pilot_has_chosen() -> None:
    bench = prepared(CLIMB, LOITER, armed=True)
    assert written(later(bench, 100, ack(MODE), heartbeat(GUIDED, armed=True))) == [TAKEOFF]
    out = later(bench, 3000, heartbeat(LOITER, armed=True))
    assert written(out) == []
    assert said(out) == [(1, Word.UNCONFIRMED, "no_ack")]


@pytest.mark.parametrize("mode", [LOITER, GUIDED])
def test_in_the_air_no_mode_is_changed_for_a_takeoff_that_would_be_refused(mode: int) -> None:
    bench = Bench(heartbeat(mode, armed=True), home(), position(10.0), landed(AIR))
    out = bench.start(1, CLIMB)
    assert (written(out), said(out)) == ([], [(1, Word.DENIED, "in_air")])


@pytest.mark.parametrize(("mode", "wrote", "word"), [(LOITER, [], "landed_state_unknown"), (GUIDED, [TAKEOFF], None)])
def test_no_mode_is_changed_for_a_takeoff_of_a_drone_that_may_be_in_the_air(
    mode: int, wrote: list[int], word: str | None
) -> None:
    """A UAV client that was started in mid-flight has no landed state yet."""
    out = Bench(heartbeat(mode, armed=True), home(), position(10.0)).start(1, CLIMB)
    assert written(out) == wrote
    assert said(out) == ([] if word is None else [(1, Word.DENIED, word)])


@pytest.mark.parametrize("shown", [px4_heartbeat(main=4, sub=2), heartbeat(LAND, armed=False)])
@pytest.mark.parametrize(("command", "number"), [(Land(), LANDING), (Return(), MODE)])
def test_an_older_arms_mode_does_not_undo_that_of_a_newer_command(command: Command, number: int, shown: Any) -> None:
    bench = Bench(shown, home(), position(), landed(GROUND))
    assert written(bench.start(1, Arm())) == [MODE]
    assert written(bench.start(2, command)) == [number]
    out = bench.until(5000)
    assert said(out)[0] == (1, Word.FAILED, "mode_changed")
    assert written(out) == [number] * 3


def test_an_older_arm_that_waits_does_not_begin_to_undo_the_mode_of_a_newer_command() -> None:
    bench = Bench(px4_heartbeat(main=4, sub=3), home(), position(), landed(GROUND))
    bench.start(1, Disarm())
    bench.until(2500)  # unanswered, so that the number rests
    assert written(bench.start(2, Arm())) == []
    assert written(bench.start(3, Return())) == [MODE]
    out = later(bench, 100, ack(MODE), ack(MODE), px4_heartbeat(main=4, sub=5))
    assert (written(out), said(out)[-1]) == ([], (2, Word.DENIED, "mode_changed"))


def test_an_arm_goes_on_behind_a_newer_command_of_the_mode_that_it_needs() -> None:
    bench = Bench(px4_heartbeat(main=4, sub=2), home(), position(), landed(GROUND))
    bench.start(1, Arm())
    bench.start(2, Hold())
    assert written(later(bench, 100, ack(MODE), ack(MODE), px4_heartbeat(main=4, sub=3))) == [ARM]


def test_px4s_second_answer_refuses_the_mode() -> None:
    bench = Bench(px4_heartbeat(main=4, sub=2), home(), position(), landed(GROUND))
    assert written(bench.start(1, Arm())) == [MODE]
    out = bench.hear(ack(MODE), ack(MODE, REFUSED))
    while not said(out):
        asked = bench.until(bench.now_ms + 100)
        out += asked + (bench.hear(ack(MODE), ack(MODE, REFUSED)) if written(asked) else [])
    assert said(out) == [(1, Word.DENIED, "wrong_mode")]


@pytest.mark.parametrize(("command", "mode", "armed", "number"), PREPARED)
def test_after_the_process_stood_still_a_mode_is_not_commanded_again(
    command: Command, mode: int, armed: bool, number: int
) -> None:
    """Its acknowledgement may have been dropped with what waited, and a pilot may have changed it back (R5.15)."""
    bench = prepared(command, mode, armed)
    bench.executor.stood_still()
    out = later(bench, 100, heartbeat(mode, armed)) + bench.until(4000)
    assert (written(out), said(out)) == ([], [(1, Word.FAILED, "wrong_mode")])


@pytest.mark.parametrize(("command", "mode", "armed", "number"), PREPARED)
def test_after_the_process_stood_still_a_command_goes_on_in_its_mode(
    command: Command, mode: int, armed: bool, number: int
) -> None:
    bench = prepared(command, mode, armed)
    bench.executor.stood_still()
    bench.until(bench.now_ms + 3000)  # the number rests
    assert written(later(bench, 100, heartbeat(GUIDED, armed))) == [number]


def test_after_the_process_stood_still_a_mode_that_was_refused_is_commanded_again() -> None:
    bench = prepared(CLIMB, LOITER, armed=True)
    bench.hear(ack(MODE, REFUSED))
    bench.executor.stood_still()
    assert written(later(bench, 600, heartbeat(LOITER, armed=True))) == [MODE]
