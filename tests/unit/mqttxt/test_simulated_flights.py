"""The roles fly the stand-in in simulated time, without any I/O, as PX4 and as ArduPilot."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.protocol.commands import Arm, Disarm, Goto, Hold, Land, Offboard, Return, Takeoff, Velocity
from mqttxt.protocol.messages import Word
from sitl.personalities import PERSONALITIES
from tests.simulation.flight import Flight

pytestmark = pytest.mark.long

HOME = (47.397742, 8.545594)
NORTH_100_M = Goto(HOME[0] + 0.0009, HOME[1], 12.0)


@pytest.fixture(params=PERSONALITIES)
def flight(request: pytest.FixtureRequest) -> Flight:
    return Flight().begin(request.param)


def test_every_command_is_flown_and_it_flies_again_after_a_landing(flight: Flight) -> None:
    place = Goto(HOME[0] + 0.0004, HOME[1], 14.0)
    velocity = Offboard(6.0, velocity=Velocity(3.0, 0.0, 0.0))
    first = (Arm(), Takeoff(10.0), place, velocity, Hold(), Land())
    second = (Arm(), Takeoff(5.0), Goto(HOME[0], HOME[1], 5.0), Return(), Arm(), Disarm())
    for command in (*first, *second):
        assert flight.outcome(command) == (Word.COMPLETED, None), command


def test_on_the_ground_nothing_but_a_takeoff_takes_off(flight: Flight) -> None:
    for command in (Takeoff(10.0), NORTH_100_M, Offboard(5.0, velocity=Velocity(0.0, 0.0, -1.0))):
        assert flight.outcome(command)[0] is Word.DENIED, command
    for command in (Hold(), Arm()):
        assert flight.outcome(command) == (Word.COMPLETED, None), command
    assert flight.outcome(NORTH_100_M)[0] is Word.DENIED
    assert flight.up_m == 0.0


def test_hold_stops_a_goto(flight: Flight) -> None:
    for command in (Arm(), Takeoff(10.0)):
        assert flight.outcome(command) == (Word.COMPLETED, None)
    goto = flight.send(NORTH_100_M)
    flight.fly(6)
    assert flight.vehicle.autopilot.motion.groundspeed_m_s > 3
    assert flight.outcome(Hold()) == (Word.COMPLETED, None)
    assert flight.vehicle.autopilot.motion.groundspeed_m_s < 1
    last = flight.last_of(goto)
    assert last is not None
    assert last.word is Word.SUPERSEDED


def test_each_kind_holds_in_the_mode_that_holds_without_sticks(flight: Flight) -> None:
    held = {"px4": "HOLD", "ardupilot": "BRAKE"}[flight.vehicle.like.name]
    for command in (Arm(), Takeoff(10.0), Hold()):
        assert flight.outcome(command) == (Word.COMPLETED, None)
    assert flight.mode == held
    assert flight.outcome(Offboard(3.0, velocity=Velocity(1.0, 0.0, 0.0))) == (Word.COMPLETED, None)
    assert flight.mode == held
    flight.fly(20)
    assert flight.up_m == pytest.approx(10.0, abs=0.5)


@pytest.mark.parametrize(
    "command",
    [Takeoff(40.0), NORTH_100_M, Land(), Return(), Offboard(60.0, velocity=Velocity(-1.0, 0.0, 0.0))],
    ids=lambda command: command.name,
)
def test_a_pilots_mode_ends_what_runs_and_stays(flight: Flight, command: Any) -> None:
    assert flight.outcome(Arm()) == (Word.COMPLETED, None)
    if not isinstance(command, Takeoff):
        assert flight.outcome(Takeoff(15.0)) == (Word.COMPLETED, None)
    sent = flight.send(command)
    flight.fly(4)
    assert flight.last_of(sent) is None
    pilots = {"px4": "altitude", "ardupilot": "alt_hold"}[flight.vehicle.like.name]
    flight.set(mode=pilots)
    flight.fly(1.2)
    last = flight.last_of(sent)
    assert last is not None
    assert (last.word, last.reason) == (Word.FAILED, "mode_changed")
    flight.fly(3)
    assert flight.mode == pilots.upper()


def test_a_takeoff_while_disarmed_leaves_nothing_that_the_next_arming_flies(flight: Flight) -> None:
    assert flight.outcome(Takeoff(10.0))[0] is Word.DENIED
    assert flight.outcome(Arm()) == (Word.COMPLETED, None)
    flight.fly(8)
    assert flight.up_m == 0.0


def test_arming_is_denied_where_it_is_not_healthy(flight: Flight) -> None:
    flight.set(healthy=False)
    flight.fly(2)
    reasons = {
        "px4": "temporarily_rejected: Arming denied: Resolve system health failures first",
        "ardupilot": "autopilot: Arm: GPS 1: Bad fix",
    }
    assert flight.outcome(Arm()) == (Word.DENIED, reasons[flight.vehicle.like.name])
