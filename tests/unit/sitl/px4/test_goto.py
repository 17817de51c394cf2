"""PX4's rules for a reposition: where it goes, from where, and how fast."""

from __future__ import annotations

import math
from typing import Any

import pytest

NAN = float("nan")
ACCEPTED, REJECTED, DENIED = 0, 1, 2
ARM, REPOSITION, SET_MODE = 400, 192, 176


@pytest.mark.parametrize(("frame", "z"), [(0, 503), (5, 503), (3, 15), (6, 15)])
def test_goto_above_sea_level_and_above_home(drone: Any, frame: int, z: float) -> None:
    drone.take_off()
    assert drone.reposition(40, -30, z, frame) == ACCEPTED
    drone.fly(30)
    _assert_at(drone, 40, -30, 15)


def test_goto_keeps_what_it_leaves_out(drone: Any) -> None:
    drone.take_off()
    assert drone.command_int(REPOSITION, -1, 1, x=2**31 - 1, y=2**31 - 1, z=NAN) == ACCEPTED
    drone.fly(10)
    _assert_at(drone, 0, 0, 10)


def test_goto_as_command_long(drone: Any) -> None:
    drone.take_off()
    place = drone.autopilot.guidance.origin.offset(50, 0, 0)
    altitude_m = 488 + 10
    answer = drone.command(REPOSITION, -1, 1, 0, NAN, place.latitude_deg, place.longitude_deg, altitude_m)
    assert answer == ACCEPTED
    drone.fly(30)
    assert drone.autopilot.motion.position[0] == pytest.approx(50, abs=1), "float32 degrees are about half a metre"


def test_goto_flies_no_faster_and_no_harder_than_its_parameters(make_drone: Any) -> None:
    """Its trajectory waits for the drone, which so never gets quite as fast."""
    drone = make_drone(MPC_XY_CRUISE=8, MPC_ACC_HOR=2)
    drone.take_off()
    assert drone.reposition(100, 0, 498) == ACCEPTED
    last, fastest, hardest = 0.0, 0.0, 0.0
    for _ in range(1000):
        drone.fly(0.02)
        speed = drone.autopilot.motion.groundspeed_m_s
        fastest, hardest, last = max(fastest, speed), max(hardest, abs(speed - last) / 0.02), speed
    assert fastest == pytest.approx(8 / (1 + 0.0019 * 64), abs=0.1)
    assert hardest <= 2.001


@pytest.mark.parametrize(("x", "z", "frame"), [(910_000_000, 500.0, 0), (0, math.inf, 0), (0, 500.0, 1)])
def test_goto_to_nowhere_is_denied(drone: Any, x: int, z: float, frame: int) -> None:
    drone.take_off()
    assert drone.command_int(REPOSITION, -1, 1, x=x, z=z, frame=frame) == DENIED


def test_goto_on_the_ground_disarmed_is_accepted_and_nothing_follows(drone: Any) -> None:
    assert drone.reposition(20, 0, 498) == ACCEPTED
    assert drone.command(ARM, 1) == ACCEPTED
    drone.fly(8)
    assert drone.autopilot.motion.position == [0.0, 0.0, 0.0]


def test_goto_on_the_ground_armed_takes_off_and_stopping_there_does_not(drone: Any) -> None:
    drone.command(ARM, 1)
    assert drone.command_int(REPOSITION, -1, 1, x=2**31 - 1, y=2**31 - 1, z=NAN) == ACCEPTED
    drone.fly(4)
    assert drone.up_m == 0.0
    assert drone.reposition(20, 0, 498) == ACCEPTED
    drone.fly(25)
    _assert_at(drone, 20, 0, 10)


def test_goto_is_refused_outside_hold_without_leave_to_change_the_mode(drone: Any) -> None:
    drone.take_off()
    drone.command(SET_MODE, 1, 4, 5)
    assert drone.command_int(REPOSITION, -1, 0, z=NAN) == REJECTED
    assert drone.mode == "RETURN"


def _assert_at(drone: Any, north_m: float, east_m: float, up_m: float) -> None:
    assert drone.autopilot.motion.position == pytest.approx([north_m, east_m, up_m], abs=0.3)
