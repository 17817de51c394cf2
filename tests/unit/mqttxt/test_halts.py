"""What stops a drone waits for no acknowledgement (R5.6): it is written beside what is open, and told by its source."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.effects import Transmit
from mqttxt.drone.mavlink.sources import HALTING, Source
from mqttxt.drone.runs import Said
from mqttxt.protocol.commands import Arm, Command, Disarm, Goto, Hold, Land, Return, Takeoff
from mqttxt.protocol.messages import Word
from tests.simulation.workbench import ARM, LAND, MODE, REPOSITION, TAKEOFF, Bench, said, written
from tests.simulation.world import ack, from_autopilot, heartbeat, home, landed, position

ON_GROUND, IN_AIR = 1, 2
THERE = Goto(47.4, 8.5, 10.0)
REJECTED: int = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
ACCEPTED, SUPERSEDED = (Word.ACCEPTED, None), (Word.SUPERSEDED, None)


def flying(state: int = IN_AIR) -> Bench:
    return Bench(heartbeat(armed=True), home(), position(), landed(state))


def sources(outputs: list[Any]) -> list[tuple[int, Source]]:
    return [(o.message.command, o.source) for o in outputs if isinstance(o, Transmit) and o.ref is not None]


@pytest.fixture
def bench() -> Bench:
    return flying()


HALTED, SENT_THERE = (REPOSITION, Source.HALT), (REPOSITION, Source.COMPANION)


def halt_ack(result: int = 0, source: Source = Source.HALT) -> Any:
    return ack(REPOSITION, result, source=source)


def test_hold_is_written_beside_a_goto_that_nobody_acknowledged_and_supersedes_it(bench: Bench) -> None:
    assert sources(bench.start(1, THERE)) == [SENT_THERE]
    assert sources(bench.start(2, Hold())) == [HALTED]
    assert said(bench.hear(halt_ack())) == [(2, *ACCEPTED), (1, *SUPERSEDED)]
    assert said(bench.hear(ack(REPOSITION))) == []  # the goto's, late


def test_hold_is_written_while_the_gotos_number_rests(bench: Bench) -> None:
    bench.start(1, THERE)
    bench.until(2600)
    assert written(bench.start(2, THERE)) == []
    assert sources(bench.start(3, Hold())) == [HALTED]


def test_a_gotos_refusal_is_not_the_holds(bench: Bench) -> None:
    bench.start(1, THERE)
    bench.start(2, Hold())
    assert said(bench.refuse(ack(REPOSITION, REJECTED))) == [(1, Word.DENIED, "temporarily_rejected")]
    assert said(bench.hear(halt_ack())) == [(2, *ACCEPTED)]


@pytest.mark.parametrize("answers", [[], [halt_ack(REJECTED)]])
def test_after_a_hold_the_goto_is_not_repeated_whatever_became_of_the_hold(answers: list[Any], bench: Bench) -> None:
    bench.start(1, THERE)
    bench.start(2, Hold())
    bench.hear(*answers)
    assert SENT_THERE not in sources(bench.until(10_000))


def test_a_takeoff_is_not_repeated_after_a_hold_on_the_ground_was_completed() -> None:
    bench = flying(ON_GROUND)
    bench.start(1, Takeoff(altitude_m=10))
    bench.start(2, Hold())
    out = bench.hear(ack(MODE, source=Source.HALT), heartbeat(armed=True), landed(ON_GROUND))
    assert said(out)[-1] == (2, Word.COMPLETED, None)
    assert TAKEOFF not in written(bench.until(10_000))


def test_hold_is_repeated_until_its_own_acknowledgement(bench: Bench) -> None:
    bench.start(1, THERE)
    bench.start(2, Hold())
    bench.hear(ack(REPOSITION))
    assert sources(bench.until(1000)) == [HALTED, HALTED]
    assert said(bench.hear(halt_ack())) == [(2, *ACCEPTED), (1, *SUPERSEDED)]
    assert sources(bench.until(5000)) == []


def test_hold_on_the_ground_waits_for_no_mode_change_either() -> None:
    bench = flying(ON_GROUND)
    assert sources(bench.start(1, Return())) == [(MODE, Source.COMPANION)]
    assert sources(bench.start(2, Hold())) == [(MODE, Source.HALT)]


def test_a_hold_does_not_wait_for_a_hold(bench: Bench) -> None:
    assert sources(bench.start(1, Hold())) == [HALTED]
    assert sources(bench.start(2, Hold())) == [(REPOSITION, Source.HALT_2)]
    assert said(bench.hear(halt_ack(source=Source.HALT_2))) == [(2, *ACCEPTED), (1, *SUPERSEDED)]
    assert said(bench.hear(halt_ack())) == []


def test_where_every_source_is_taken_the_first_acknowledgement_is_the_older_holds(bench: Bench) -> None:
    written_by = [source for seq in range(4) for _, source in sources(bench.start(seq, Hold()))]
    assert written_by == [*HALTING, HALTING[-1]]
    assert said(bench.hear(halt_ack(source=HALTING[-1])))[0] == (2, *ACCEPTED)
    assert said(bench.hear(halt_ack(source=HALTING[-1])))[0] == (3, *ACCEPTED)


@pytest.mark.parametrize(("command", "number"), [(Land(), LAND), (Return(), MODE), (Disarm(), ARM)])
def test_what_stops_a_drone_does_not_wait_for_a_number_that_rests(command: Command, number: int) -> None:
    bench = flying(ON_GROUND)
    assert sources(bench.start(1, command)) == [(number, Source.COMPANION)]
    assert sources(bench.start(2, command)) == [(number, Source.HALT)]
    assert said(bench.until(2600))[-1] == (2, Word.UNCONFIRMED, "no_ack")
    assert sources(bench.start(3, command)) == [(number, Source.HALT_2)]
    assert said(bench.hear(ack(number, source=Source.HALT))) == []  # the second one's, late
    assert said(bench.hear(ack(number, source=Source.HALT_2)))[0] == (3, *ACCEPTED)


def test_disarm_does_not_wait_for_an_arm_which_is_not_written_again_behind_it() -> None:
    bench = Bench(heartbeat(), home(), position(), landed(ON_GROUND))
    assert sources(bench.start(1, Arm())) == [(ARM, Source.COMPANION)]
    assert sources(bench.start(2, Disarm())) == [(ARM, Source.HALT)]
    assert said(bench.hear(ack(ARM))) == [(1, *ACCEPTED)]
    assert said(bench.hear(ack(ARM, source=Source.HALT))) == [(2, *ACCEPTED), (1, *SUPERSEDED)]
    assert written(bench.until(10_000)) == []


def test_an_arm_still_waits_for_a_disarms_acknowledgement() -> None:
    bench = Bench(heartbeat(), home(), position(), landed(ON_GROUND))
    bench.start(1, Disarm())
    assert written(bench.start(2, Arm())) == []


LAST = HALTING[-1]


def sharing(state: int = IN_AIR) -> Bench:
    """A bench on which holds 2 and 3 were written by the same component."""
    bench = flying(state)
    for seq in range(4):
        bench.start(seq, Hold())
    return bench


def test_a_refusal_is_not_the_older_holds_where_the_newer_one_may_have_drawn_it() -> None:
    """The acknowledgement of the older one was lost: that it was denied would be a false no."""
    bench = sharing()
    heard = bench.hear(halt_ack(REJECTED, LAST)) + bench.until(10_000)
    words = {seq: word for seq, word, _ in said(heard)}
    assert words[2] is words[3] is Word.UNCONFIRMED


def test_holds_that_share_a_component_are_denied_once_every_copy_of_both_was() -> None:
    bench = sharing()
    assert said(bench.refuse(halt_ack(REJECTED, LAST))) == []
    found = said(bench.refuse(halt_ack(REJECTED, LAST)))
    assert found == [(seq, Word.DENIED, "temporarily_rejected") for seq in (2, 3)]


def test_a_refusal_behind_the_older_holds_acceptance_is_not_its_second_acknowledgement() -> None:
    bench = sharing(ON_GROUND)
    assert said(bench.hear(ack(MODE, source=LAST)))[0] == (2, *ACCEPTED)
    words = said(bench.hear(ack(MODE, REJECTED, source=LAST)))
    assert (2, Word.FAILED) not in [(seq, word) for seq, word, _ in words]


def test_the_late_acknowledgement_of_an_older_hold_is_not_taken_for_the_newer(bench: Bench) -> None:
    for seq in range(3):
        bench.start(seq, Hold())
    bench.start(3, THERE)
    bench.hear(ack(REPOSITION))
    (taken,) = sources(bench.start(4, Hold()))
    assert said(bench.hear(halt_ack(source=HALTING[-1]))) == []  # the third one's
    assert sources(bench.until(600)) == [taken]
    assert said(bench.hear(halt_ack(source=HALTING[-1]))) == [(4, *ACCEPTED), (3, *SUPERSEDED)]


@pytest.mark.parametrize("target", [(0, 0), (1, 0)])
def test_an_acknowledgement_that_names_no_component_is_the_gotos_first(target: tuple[int, int], bench: Bench) -> None:
    nobodys = from_autopilot(mavlink.MAVLink_command_ack_message(REPOSITION, 0, 0, 0, *target))
    bench.start(1, THERE)
    bench.start(2, Hold())
    assert said(bench.hear(nobodys)) == [(1, *ACCEPTED)]
    assert said(bench.hear(nobodys)) == [(2, *ACCEPTED), (1, *SUPERSEDED)]


NAMELESS: Any = from_autopilot(mavlink.MAVLink_command_ack_message(ARM, REJECTED, 0, 0, 0, 0))


def test_a_refusal_that_names_no_component_is_no_definite_no_while_it_may_be_of_another_command() -> None:
    """MAVLink 1 has no target in COMMAND_ACK; the acknowledgement of the arm was lost."""
    bench = Bench(heartbeat(), home(), position(), landed(ON_GROUND))
    bench.start(1, Arm())
    bench.start(2, Disarm())
    heard = bench.hear(NAMELESS) + bench.until(10_000)
    assert [(seq, word) for seq, word, _ in said(heard)] == [(1, Word.UNCONFIRMED), (2, Word.UNCONFIRMED)]


def test_refusals_that_name_no_component_are_denials_once_every_copy_of_all_was_refused() -> None:
    bench = Bench(heartbeat(), home(), position(), landed(ON_GROUND))
    bench.start(1, Arm())
    bench.start(2, Disarm())
    assert said(bench.refuse(NAMELESS)) == []
    assert said(bench.refuse(NAMELESS)) == [(seq, Word.DENIED, "temporarily_rejected") for seq in (1, 2)]


def test_a_refusal_that_names_no_component_may_be_of_the_clients_own_change_of_mode() -> None:
    bench = Bench(heartbeat(main=4, sub=4), home(), position(), landed(ON_GROUND))
    assert written(bench.start(1, Arm())) == [MODE]  # hold, before it arms
    assert sources(bench.start(2, Return())) == [(MODE, Source.HALT)]
    refused = from_autopilot(mavlink.MAVLink_command_ack_message(MODE, REJECTED, 0, 0, 0, 0))
    words = {seq: word for seq, word, _ in said(bench.hear(refused) + bench.until(2000))}
    assert words[2] is Word.UNCONFIRMED


class Link:
    """Acknowledges what arrives, in the writes' order; an acknowledgement may be lost or late."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.commands: dict[int, Command] = {}
        self.answered: set[int] = set()
        self.newest_hold = -1
        self._due: list[tuple[int, int, Any]] = []

    def carry(self, outputs: list[Any], late_tenths: int | None) -> None:
        for output in outputs:
            if isinstance(output, Said):
                self._judge(output)
            elif isinstance(output, Transmit) and output.ref is not None:
                seq = output.ref.seq  # type: ignore[attr-defined]
                if isinstance(self.commands[seq], Hold):
                    self.newest_hold = max(self.newest_hold, seq)
                assert seq >= self.newest_hold, "said again after a newer hold"
                if late_tenths is not None:
                    at_ms = max([self.bench.now_ms + 100 * late_tenths, *(due[0] for due in self._due)])
                    self._due.append((at_ms, seq, ack(output.message.command, source=output.source)))

    def tick(self, late_tenths: int | None) -> None:
        self.carry(self.bench.until(self.bench.now_ms + 100), late_tenths)
        while self._due and self._due[0][0] <= self.bench.now_ms:
            _, seq, message = self._due.pop(0)
            self.answered.add(seq)
            self.carry(self.bench.hear(message), late_tenths)

    def _judge(self, said: Said) -> None:
        if said.word is Word.ACCEPTED:
            kind = type(self.commands[said.id.seq])
            likes = [seq for seq in self.answered if type(self.commands[seq]) is kind and seq >= said.id.seq]
            assert said.id.seq in self.answered or (kind in (Hold, Land) and likes), (
                "accepted by the answer to an earlier command"
            )


EVENTS = st.lists(
    st.tuples(
        st.sampled_from([THERE, Hold(), Land(), None]),
        st.sampled_from([0, 1, 7, 31]),
        st.sampled_from([None, 0, 3, 25]),
    ),
    max_size=20,
)


@given(EVENTS)
@example([(THERE, 0, None), (Hold(), 0, None), (THERE, 0, 0), (Hold(), 0, 25), (Hold(), 31, None)])
@example([(Hold(), 0, 25), (THERE, 1, 0), (Hold(), 7, None), (Hold(), 31, 3)])
@settings(deadline=None)
def test_whatever_acknowledgements_are_lost_or_late_a_hold_or_landing_is_written_at_once(events: Any) -> None:
    """Each event: a command, tenths of a second after it, and how late what is written then is acknowledged."""
    bench = flying()
    link = Link(bench)
    for seq, (command, tenths, late_tenths) in enumerate(events):
        if command is not None:
            link.commands[seq] = command
            out = bench.start(seq, command, bench.now_ms + 5000, 60_000)
            if isinstance(command, Hold | Land):
                assert [source in HALTING or command == Land() for _, source in sources(out)] == [True]
            link.carry(out, late_tenths)
        for _ in range(tenths):
            link.tick(late_tenths)


def test_a_lost_hold_of_the_ground_is_written_as_one_of_the_air_once_the_drone_has_left_it() -> None:
    bench = flying(ON_GROUND)
    bench.start(1, Takeoff(50.0))
    bench.hear(ack(TAKEOFF), heartbeat(armed=True, main=4, sub=2))
    bench.until(300)
    assert written(bench.start(2, Hold(), deadline_ms=5000)) == [MODE]
    bench.until(500)
    bench.hear(landed(3))
    assert written(bench.until(4000)) == [REPOSITION] * 3  # four times in all


@pytest.mark.parametrize(("command", "number"), [(Hold(), REPOSITION), (Land(), 21), (Return(), MODE)])
def test_what_brings_a_drone_down_needs_no_heartbeat_of_an_autopilot_that_is_heard(
    command: Command, number: int, bench: Bench
) -> None:
    for now_ms in range(100, 8000, 100):
        bench.now_ms = now_ms
        bench.hear(position(20.0), landed(IN_AIR))
    assert said(bench.start(1, THERE, deadline_ms=16_000)) == [(1, Word.DENIED, "no_autopilot")]
    assert written(bench.start(2, command, deadline_ms=16_000)) == [number]
    bench.now_ms += 3100
    assert said(bench.start(3, command, deadline_ms=16_000)) == [(3, Word.DENIED, "no_autopilot")]
