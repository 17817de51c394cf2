"""Motion and battery."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl.dynamics import Battery, Motion, Place, approach

HOME = Place(47.397742, 8.545594, 488.0)


@given(st.floats(-500, 500), st.floats(-500, 500))
def test_metres_to_and_offset_are_inverse(north_m: float, east_m: float) -> None:
    there = HOME.offset(north_m, east_m, 5.0)
    assert HOME.metres_to(there.latitude_deg, there.longitude_deg) == pytest.approx((north_m, east_m), abs=1e-3)
    assert there.altitude_m == 493.0


def test_a_minute_of_latitude_is_a_nautical_mile() -> None:
    assert HOME.metres_to(HOME.latitude_deg + 1 / 60, HOME.longitude_deg)[0] == pytest.approx(1853, abs=1)


def test_velocity_changes_no_faster_than_the_acceleration() -> None:
    motion = Motion(position=[0.0, 0.0, 10.0])
    motion.step((10.0, 10.0, 10.0), 3.0, 0.1)
    assert math.hypot(motion.velocity[0], motion.velocity[1]) == pytest.approx(0.3)
    assert motion.velocity[2] == pytest.approx(0.2)


def test_the_ground_stops_it() -> None:
    motion = Motion(position=[0.0, 0.0, 0.01], velocity=[1.0, 0.0, -1.0])
    motion.step((1.0, 0.0, -1.0), 3.0, 0.1)
    assert motion.position[2] == 0.0
    assert motion.velocity == [0.0, 0.0, 0.0]


@given(st.floats(-1000, 1000))
def test_approach_goes_the_right_way_and_can_stop(distance_m: float) -> None:
    speed = approach(distance_m, 12.0, 3.0)
    assert speed * distance_m >= 0
    assert speed**2 <= 2 * 3.0 * abs(distance_m) + 1e-9
    assert abs(speed) <= 12.0


def _minutes(motion: Motion) -> float:
    battery = Battery(70.0, 70.0)
    battery.step(motion, True, 60.0)
    return 70.0 / (70.0 - battery.left_wh)


def test_a_battery_lasts_fifteen_to_twenty_minutes() -> None:
    assert 15 <= _minutes(Motion(velocity=[5.0, 0.0, 0.0])) <= _minutes(Motion()) <= 20


def test_climbing_and_moving_drain_faster() -> None:
    hovering = _minutes(Motion())
    assert _minutes(Motion(velocity=[0.0, 0.0, 2.0])) < _minutes(Motion(velocity=[5.0, 0.0, 0.0])) < hovering
    assert _minutes(Motion(velocity=[0.0, 0.0, -2.0])) == hovering


def test_a_battery_never_holds_less_than_nothing() -> None:
    battery = Battery(70.0, 0.001)
    battery.step(Motion(), True, 60.0)
    assert battery.remaining_pct == 0.0
