"""Motion and battery."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl.dynamics import LAG_S, Battery, Limits, Motion, Place, SimulatedBattery, approach

HOME = Place(47.397742, 8.545594, 488.0)
LIMITS = Limits(3.0, 4.0, 3.0, 4.0)


@given(st.floats(-500, 500), st.floats(-500, 500))
def test_metres_to_and_offset_are_inverse(north_m: float, east_m: float) -> None:
    there = HOME.offset(north_m, east_m, 5.0)
    assert HOME.metres_to(there.latitude_deg, there.longitude_deg) == pytest.approx((north_m, east_m), abs=1e-3)
    assert there.altitude_m == 493.0


def test_a_minute_of_latitude_is_a_nautical_mile() -> None:
    assert HOME.metres_to(HOME.latitude_deg + 1 / 60, HOME.longitude_deg)[0] == pytest.approx(1853, abs=1)


def test_velocity_changes_no_faster_than_the_acceleration() -> None:
    motion = Motion(position=[0.0, 0.0, 10.0])
    last, hardest = list(motion.aim), [0.0, 0.0, 0.0]
    for _ in range(500):
        motion.step((10.0, 10.0, 10.0), LIMITS, 0.02)
        hardest = [max(h, abs(a - b) / 0.02) for h, a, b in zip(hardest, motion.aim, last, strict=True)]
        last = list(motion.aim)
    assert math.hypot(hardest[0], hardest[1]) <= 3.001
    assert hardest[2] <= 4.001
    assert motion.velocity == pytest.approx([10.0, 10.0, 10.0], abs=0.01)


def test_acceleration_changes_no_faster_than_the_jerk() -> None:
    motion = Motion(position=[0.0, 0.0, 10.0])
    last = list(motion.acceleration)
    for _ in range(200):
        motion.step((5.0, 0.0, -1.0), LIMITS, 0.02)
        assert all(abs(a - b) <= 4.0 * 0.02 + 1e-9 for a, b in zip(motion.acceleration, last, strict=True))
        last = list(motion.acceleration)


def test_the_drone_is_behind_its_trajectory() -> None:
    motion = Motion(position=[0.0, 0.0, 10.0], aim=[4.0, 0.0, 0.0])
    motion.step((4.0, 0.0, 0.0), LIMITS, 0.02)
    assert motion.velocity[0] == pytest.approx(4.0 * 0.02 / LAG_S)


def test_the_heading_turns_to_where_it_flies_the_short_way() -> None:
    motion = Motion(position=[0.0, 0.0, 10.0], yaw_rad=math.radians(170), yaw_aim_rad=math.radians(170))
    for _ in range(300):
        motion.step((-3.0, -1.0, 0.0), LIMITS, 0.02)
        assert abs(motion.yaw_rad) > math.radians(160)
    assert motion.yaw_rad == pytest.approx(math.atan2(-1.0, -3.0), abs=1e-6)


def test_the_ground_stops_it() -> None:
    motion = Motion(position=[0.0, 0.0, 0.01], velocity=[1.0, 0.0, -1.0], aim=[1.0, 0.0, -1.0])
    motion.step((1.0, 0.0, -1.0), LIMITS, 0.1)
    assert motion.position[2] == 0.0
    assert motion.velocity == [0.0, 0.0, 0.0]


@given(st.floats(-1000, 1000))
def test_approach_goes_the_right_way_and_can_stop(distance_m: float) -> None:
    speed = approach(distance_m, 12.0, 3.0, 4.0)
    assert speed * distance_m >= 0
    assert speed**2 <= 2 * 3.0 * abs(distance_m) + 1e-9
    assert abs(speed) <= 12.0


def _minutes(motion: Motion) -> float:
    battery = Battery(70.0, 70.0)
    battery.step(motion, True, True, 60.0)
    return 70.0 / (70.0 - battery.left_wh)


def test_a_battery_lasts_fifteen_to_twenty_minutes() -> None:
    assert 15 <= _minutes(Motion(velocity=[5.0, 0.0, 0.0])) <= _minutes(Motion()) <= 20


def test_climbing_and_moving_drain_faster() -> None:
    hovering = _minutes(Motion())
    assert _minutes(Motion(velocity=[0.0, 0.0, 2.0])) < _minutes(Motion(velocity=[5.0, 0.0, 0.0])) < hovering
    assert _minutes(Motion(velocity=[0.0, 0.0, -2.0])) == hovering


def test_a_battery_never_holds_less_than_nothing() -> None:
    battery = Battery(70.0, 0.001)
    battery.step(Motion(), True, True, 60.0)
    assert battery.remaining_pct == 0.0


def test_px4s_simulated_battery_drains_while_armed_to_its_least_and_is_full_when_disarmed() -> None:
    battery = SimulatedBattery(60.0, 50.0)
    battery.step(Motion(), True, False, 15.0)
    assert battery.remaining_pct == pytest.approx(75.0)
    battery.step(Motion(), True, True, 60.0)
    assert battery.remaining_pct == 50.0
    battery.step(Motion(), False, False, 0.02)
    assert battery.remaining_pct == 100.0
