"""An armed drone never does what it was not commanded to (section 5): what PX4 would accept is not said to it."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mqttxt.drone.effects import Transmit
from mqttxt.drone.mavlink.sources import Source
from mqttxt.drone.runs import Said
from mqttxt.protocol.commands import Arm, Command, Disarm, Goto, Hold, Land, Offboard, Takeoff, Velocity
from mqttxt.protocol.messages import Word
from tests.simulation.workbench import ARM, MODE, REPOSITION, TAKEOFF, Bench, said, written
from tests.simulation.world import ack, heartbeat, home, landed, position

GROUND, AIR = 1, 2
THERE = Goto(47.4, 8.5, 10.0)
NORTH = Offboard(10.0, velocity=Velocity(1.0, 0.0, 0.0))
IN_TAKEOFF, IN_HOLD = (4, 2), (4, 3)
MOVES_WHEN_ARMED = [IN_TAKEOFF, (4, 4), (4, 5), (4, 6), (6, 0), (9, 9)]


def told(armed: bool, state: int, mode: tuple[int, int] = IN_HOLD) -> tuple[Any, ...]:
    return heartbeat(armed=armed, main=mode[0], sub=mode[1]), home(), position(), landed(state)


def moving(north_m_s: float, up_m_s: float = 0.0, altitude_m: float = 10.0) -> Any:
    place = position(altitude_m)
    place.vx, place.vz = round(north_m_s * 100), round(-up_m_s * 100)
    return place


@pytest.mark.parametrize(
    ("command", "armed", "state", "reason"),
    [
        (Takeoff(altitude_m=10), False, GROUND, "disarmed"),
        (THERE, True, GROUND, "on_ground"),
        (THERE, False, GROUND, "on_ground"),
        (THERE, True, 0, "landed_state_unknown"),
        (THERE, False, AIR, "disarmed"),
    ],
)
def test_what_would_move_the_drone_unasked_is_denied(command: Command, armed: bool, state: int, reason: str) -> None:
    out = Bench(*told(armed, state)).start(1, command)
    assert said(out) == [(1, Word.DENIED, reason)]
    assert written(out) == []


def test_without_a_landed_state_nobody_knows_that_a_goto_would_not_take_off() -> None:
    assert said(Bench(heartbeat(armed=True), home()).start(1, THERE)) == [(1, Word.DENIED, "landed_state_unknown")]


def test_what_was_heard_of_the_ground_long_ago_says_nothing_of_a_goto() -> None:
    """The state of a flight before, whose messages have stopped: on the ground PX4 takes off for a goto."""
    bench = Bench(*told(True, AIR))
    bench.until(3100)
    assert said(bench.start(1, THERE)) == [(1, Word.DENIED, "landed_state_unknown")]
    bench.hear(landed(AIR))
    assert written(bench.start(2, THERE)) == [REPOSITION]


def test_a_landed_state_that_does_not_exist_keeps_no_older_one_known() -> None:
    bench = Bench(*told(True, AIR))
    while bench.now_ms <= 3000:
        bench.until(bench.now_ms + 200)
        bench.hear(landed(77))
    assert said(bench.start(1, THERE)) == [(1, Word.DENIED, "landed_state_unknown")]


def test_nothing_that_waited_is_written_to_an_autopilot_that_fell_silent() -> None:
    """It may have been started anew: what it said of itself before holds no longer."""
    bench = Bench(*told(True, GROUND))
    (out,) = bench.start(1, Takeoff(altitude_m=10))
    bench.executor.on_refused(out.ref, False, 0)  # its link takes nothing
    bench.now_ms = 3100
    assert said(bench.executor.tick(3100)) == [(1, Word.DENIED, "no_autopilot")]


def test_offboard_is_not_begun_while_disarmed() -> None:
    bench = Bench(*told(False, GROUND))
    bench.executor.lease.until_ms, bench.executor.lease.holder_session = 10_000, 1
    assert said(bench.start(1, NORTH)) == [(1, Word.DENIED, "disarmed")]


def test_a_takeoff_that_had_to_wait_is_not_written_once_the_drone_is_disarmed() -> None:
    bench = Bench(*told(True, GROUND))
    bench.start(1, Takeoff(altitude_m=10))
    bench.until(2500)
    assert written(bench.start(2, Takeoff(altitude_m=20))) == []
    bench.hear(heartbeat(armed=False))
    assert said(bench.until(2600)) == [(2, Word.DENIED, "disarmed")]


def test_a_takeoff_is_not_repeated_once_the_drone_is_disarmed() -> None:
    bench = Bench(*told(True, GROUND))
    assert written(bench.start(1, Takeoff(altitude_m=10))) == [TAKEOFF]
    bench.hear(heartbeat(armed=False))
    out = bench.until(5000)
    assert written(out) == []
    assert said(out) == [(1, Word.UNCONFIRMED, "no_ack")]


@pytest.mark.parametrize("answers", [[ack(TAKEOFF)], []])
def test_a_takeoff_that_left_a_disarmed_drone_in_its_mode_is_undone(answers: list[Any]) -> None:
    bench = Bench(*told(True, GROUND))
    bench.start(1, Takeoff(altitude_m=10))
    left = heartbeat(armed=False, main=4, sub=2)
    out = bench.hear(*answers, left) + bench.until(1400)
    assert [o for o in said(out) if o[1].is_last] == [
        (1, Word.FAILED, "disarmed") if answers else (1, Word.UNCONFIRMED, "no_ack")
    ]
    again = bench.until(2000)
    assert set(written(out + again)) == {MODE}
    bench.hear(ack(MODE), heartbeat(armed=False))
    assert written(bench.until(20_000)) == []


def test_after_the_process_stood_still_a_takeoff_is_undone_once_a_heartbeat_shows_it() -> None:
    """The drone may have been armed since, and a pilot may fly it (R5.15)."""
    bench = Bench(*told(True, GROUND))
    left = heartbeat(armed=False, main=4, sub=2)
    bench.start(1, Takeoff(altitude_m=10))
    assert written(bench.hear(ack(TAKEOFF), left)) == [MODE]
    bench.executor.stood_still()
    assert written(bench.until(2000)) == []
    assert written(bench.hear(left)) == [MODE]


def test_a_pilots_takeoff_mode_long_after_a_takeoff_is_left_alone() -> None:
    bench = Bench(*told(True, GROUND))
    bench.start(1, Takeoff(altitude_m=10))
    bench.hear(heartbeat(armed=False))
    bench.until(11_000)
    bench.hear(heartbeat(armed=False))
    assert written(bench.hear(heartbeat(armed=False, main=4, sub=2)) + bench.until(20_000)) == []


def test_a_takeoff_mode_that_was_not_ours_is_left_alone() -> None:
    bench = Bench(*told(False, GROUND))
    bench.hear(heartbeat(armed=False, main=4, sub=2))
    assert written(bench.until(20_000)) == []


@pytest.mark.parametrize("mode", MOVES_WHEN_ARMED)
def test_arm_puts_a_drone_into_hold_first_where_it_would_fly_off(mode: tuple[int, int]) -> None:
    bench = Bench(*told(False, GROUND, mode))
    out = bench.start(1, Arm())
    (hold,) = [o.message for o in out if isinstance(o, Transmit)]
    assert (hold.command, hold.param2, hold.param3) == (MODE, 4.0, 3.0)
    bench.hear(ack(MODE))
    assert written(bench.until(400)) == []
    bench.hear(heartbeat(armed=False))
    assert written(bench.until(500)) == [ARM]
    assert said(bench.hear(ack(ARM), heartbeat(armed=True)))[-1] == (1, Word.COMPLETED, None)


def test_the_mode_that_comes_first_is_bound_by_the_deadline_too() -> None:
    bench = Bench(*told(False, GROUND, IN_TAKEOFF))
    out = bench.start(1, Arm(), deadline_ms=700) + bench.until(2000)
    assert {o.not_after_ms for o in out if isinstance(o, Transmit)} == {700}
    assert said(out) == [(1, Word.FAILED, "expired")]


@pytest.mark.parametrize("main", [1, 2, 3, 5, 7])
def test_arm_leaves_a_pilots_mode_as_it_is(main: int) -> None:
    assert written(Bench(*told(False, GROUND, (main, 0))).start(1, Arm())) == [ARM]


def test_arm_in_flight_changes_no_mode() -> None:
    assert written(Bench(*told(True, AIR, IN_TAKEOFF)).start(1, Arm())) == [ARM]


@pytest.mark.parametrize(
    ("armed", "state", "number"),
    [(True, GROUND, MODE), (True, 0, REPOSITION), (True, AIR, REPOSITION), (True, 3, REPOSITION), (False, 0, MODE)],
)
def test_hold_is_a_reposition_in_the_air_and_a_mode_on_the_ground(armed: bool, state: int, number: int) -> None:
    assert written(Bench(*told(armed, state)).start(1, Hold())) == [number]


@pytest.mark.parametrize(("armed", "number"), [(True, REPOSITION), (False, MODE)])
def test_a_hold_stops_an_armed_drone_whose_landed_state_of_the_ground_is_old(armed: bool, number: int) -> None:
    """It may be in the air by now, where DO_SET_MODE would not stop a goto."""
    bench = Bench(*told(armed, GROUND))
    bench.until(3100)
    assert written(bench.start(1, Hold())) == [number]


def test_a_hold_of_the_air_is_not_repeated_on_the_ground() -> None:
    """Landing meanwhile: a reposition of a drone that stands on the ground is a takeoff."""
    bench = Bench(*told(True, AIR))
    assert written(bench.start(1, Hold())) == [REPOSITION]
    bench.hear(landed(GROUND))
    out = bench.until(5000)
    assert written(out) == []
    assert said(out) == [(1, Word.UNCONFIRMED, "no_ack")]


def test_hold_is_completed_when_the_drone_stands_still() -> None:
    bench = Bench(*told(True, AIR))
    bench.start(1, Hold())
    assert said(bench.hear(moving(0.0), ack(REPOSITION, source=Source.HALT), heartbeat(armed=True))) == [
        (1, Word.ACCEPTED, None)
    ]
    for step in range(1, 50):
        bench.now_ms += 100
        slow = step % 8 >= 4  # never for a second
        assert said(bench.hear(moving(0.2 if slow else 3.0), heartbeat(armed=True))) == []
    for _ in range(10):
        assert said(bench.hear(moving(0.0, up_m_s=0.4))) == []
        bench.now_ms += 100
    assert said(bench.hear(moving(0.3))) == [(1, Word.COMPLETED, None)]


def test_hold_is_not_completed_while_it_climbs_or_in_another_mode() -> None:
    climbing, elsewhere = Bench(*told(True, AIR)), Bench(*told(True, AIR))
    for bench, climb, mode in ((climbing, 0.6, 3), (elsewhere, 0.0, 5)):
        bench.hear(heartbeat(armed=True, main=4, sub=mode))
        bench.start(1, Hold())
        assert said(bench.hear(ack(REPOSITION, source=Source.HALT))) == [(1, Word.ACCEPTED, None)]
        for _ in range(25):
            bench.now_ms += 100
            assert said(bench.hear(moving(0.0, climb), heartbeat(armed=True, main=4, sub=mode))) == []


def test_hold_on_the_ground_is_completed_without_a_position() -> None:
    bench = Bench(*told(True, GROUND))
    bench.start(1, Hold())
    accepted = ack(MODE, source=Source.HALT)
    assert said(bench.hear(accepted, heartbeat(armed=True), landed(GROUND)))[-1] == (1, Word.COMPLETED, None)


@pytest.mark.parametrize(("altitude_m", "over"), [(5.0, True), (9.0, False)])
def test_a_pilots_hold_in_a_takeoff_is_told_from_the_autopilots_own(altitude_m: float, over: bool) -> None:
    bench = Bench(*told(True, GROUND))
    bench.start(1, Takeoff(altitude_m=10))
    bench.hear(ack(TAKEOFF), heartbeat(armed=True, main=4, sub=2), landed(3), moving(0.0, 1.5, altitude_m))
    out = said(bench.hear(heartbeat(armed=True)))
    assert out == ([(1, Word.FAILED, "mode_changed")] if over else [])


class Px4:
    """As PX4 is with what would hurt: it accepts everything, and flies when it is armed in its takeoff mode."""

    def __init__(self) -> None:
        self.armed, self.mode, self.flies = False, IN_HOLD, False

    def take(self, message: Any) -> int | None:
        """Carry out a write; its MAV_CMD, None for what is no command."""
        command = getattr(message, "command", None)
        if command == ARM:
            self.armed = message.param1 == 1.0
        elif command == TAKEOFF:
            self.mode = IN_TAKEOFF
        elif command == MODE:
            self.mode = (int(message.param2), int(message.param3))
        elif command == REPOSITION:
            self.mode = IN_HOLD
            self.flies |= self.armed and message.get_type() == "COMMAND_INT"
        return command


COMMANDS = st.sampled_from([Arm(), Disarm(), Takeoff(altitude_m=10), THERE, Hold(), Land()])
ARMED_BY_OTHERS = st.sampled_from([None, None, True, False])
EVENTS = st.lists(
    st.tuples(COMMANDS | st.none(), st.sampled_from([0, 5, 12, 30]), st.booleans(), ARMED_BY_OTHERS), max_size=15
)


ARMED = (None, 12, False, True)
CLIMB = Takeoff(altitude_m=10)


@given(EVENTS)
@example([ARMED, (CLIMB, 12, False, False), (None, 0, False, True)])
@example([ARMED, (CLIMB, 5, True, False), (None, 30, True, None), (None, 0, True, True)])
@example([(CLIMB, 12, False, None), (Arm(), 30, False, None)])
@settings(deadline=None)
def test_whatever_is_lost_or_done_by_others_it_flies_only_while_a_takeoff_is_open(events: Any) -> None:
    """Each event: a command, tenths of a second, whether acknowledgements are lost, whether others arm or disarm."""
    px4, bench, wanted = Px4(), Bench(*told(False, GROUND)), dict[int, Command]()
    since_heartbeat = 0

    def look() -> None:
        if px4.flies or (px4.armed and px4.mode == IN_TAKEOFF):
            assert any(isinstance(command, Takeoff) for command in wanted.values())
            px4.armed, px4.mode, px4.flies = False, IN_HOLD, False  # landed again

    def carry(outputs: list[Any], muted: bool) -> None:
        for output in outputs:
            if isinstance(output, Said) and output.word.is_last:
                wanted.pop(output.id.seq)
            elif isinstance(output, Transmit):
                number = px4.take(output.message)
                look()
                if number is not None and not muted:
                    carry(bench.hear(ack(number, source=output.source)), muted)

    for seq, (command, tenths, muted, by_others) in enumerate(events):
        px4.armed = px4.armed if by_others is None else by_others
        look()
        if command is not None:
            wanted[seq] = command
            carry(bench.start(seq, command, bench.now_ms + 5000, 20_000), muted)
        for _ in range(tenths):
            carry(bench.until(bench.now_ms + 100), muted)
            since_heartbeat += 1
            if since_heartbeat >= 10:
                since_heartbeat = 0
                carry(bench.hear(*told(px4.armed, GROUND, px4.mode)), muted)
