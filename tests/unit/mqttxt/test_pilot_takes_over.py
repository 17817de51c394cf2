"""A pilot's change wins: no write of ours follows it, whether or not the autopilot's acknowledgement was lost."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.protocol.commands import Arm, Command, Disarm, Hold, Land, Return, StartMission
from mqttxt.protocol.messages import Word
from tests.simulation.workbench import ARM, LAND, MODE, Bench, said, set_points, written
from tests.simulation.world import heartbeat, home, landed, position
from tests.unit.mqttxt.test_offboard import NORTH, Flight, in_hold, in_offboard


def by_pilot() -> Any:
    """A heartbeat in PX4's mode POSITION."""
    return heartbeat(armed=True, main=3, sub=0)


@pytest.mark.parametrize(("command", "was_armed"), [(Arm(), False), (Disarm(), True)])
def test_what_has_shown_without_its_acknowledgement_is_not_written_again(command: Command, was_armed: bool) -> None:
    bench = Bench(heartbeat(armed=was_armed), home(), position(), landed(1))
    assert written(bench.start(1, command, deadline_ms=5000)) == [ARM]
    bench.until(200)
    bench.hear(heartbeat(armed=not was_armed))
    bench.until(400)
    bench.hear(heartbeat(armed=was_armed))  # the pilot undoes it
    out = bench.until(4000)
    assert written(out) == []
    assert said(out) == [(1, Word.ACCEPTED, None), (1, Word.COMPLETED, None)]


def test_an_arm_that_has_not_shown_is_written_again() -> None:
    bench = Bench(heartbeat(), home(), position(), landed(1))
    bench.start(1, Arm(), deadline_ms=5000)
    bench.hear(heartbeat())
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


def test_a_return_that_waits_for_its_number_is_not_written_behind_a_pilot() -> None:
    bench = Bench(heartbeat(armed=True), home(), position(20.0), landed(2))
    bench.start(1, Return(), deadline_ms=10_000)
    bench.until(3200)  # never acknowledged: the number rests
    bench.start(2, Return(), deadline_ms=10_000)
    bench.until(3600)
    bench.hear(by_pilot())
    out = bench.until(9000)
    assert MODE not in written(out)
    assert (2, Word.DENIED, "mode_changed") in said(out)
