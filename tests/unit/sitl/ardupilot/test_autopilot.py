"""The stand-in as ArduCopter: whole flights, in simulated time."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

GUIDED, RTL, LAND, BRAKE, LOITER = 4, 6, 9, 17, 5
ACCEPTED = 0


def test_it_stays_on_the_ground_armed_and_disarms_after_its_delay(make_copter: Any) -> None:
    copter = make_copter()
    copter.command(400, 1)
    assert copter.fly_until(lambda: not copter.autopilot.armed) == pytest.approx(10, abs=0.2)
    assert (copter.up_m, copter.mode) == (0.0, "GUIDED")
    copter = make_copter(COM_DISARM_PRFLT=0)
    copter.command(400, 1)
    copter.fly(60)
    assert copter.autopilot.armed


def test_a_takeoff_climbs_to_its_height_above_home_and_stays_in_guided(copter: Any) -> None:
    copter.command(400, 1)
    copter.command(22, *[0.0] * 6, 20.0)
    copter.fly_until(lambda: copter.up_m > 10)
    assert copter.autopilot.motion.velocity[2] == pytest.approx(2.5, abs=0.05)
    assert copter.autopilot.landed_state == mavlink.MAV_LANDED_STATE_TAKEOFF
    copter.fly(20)
    assert copter.up_m == pytest.approx(20, abs=0.1)
    assert (copter.mode, copter.autopilot.landed_state) == ("GUIDED", mavlink.MAV_LANDED_STATE_IN_AIR)
    assert copter.vehicle.telemetry.make("POSITION_TARGET_GLOBAL_INT").alt == pytest.approx(508)


def test_a_goto_arrives_and_brake_stops_one_under_way(copter: Any) -> None:
    copter.take_off()
    assert copter.go(50, 0, 15) == ACCEPTED
    copter.fly(30)
    assert copter.autopilot.motion.position == pytest.approx([50, 0, 15], abs=0.3)
    copter.go(250, 0, 15)
    copter.fly_until(lambda: copter.autopilot.motion.groundspeed_m_s > 8)
    north_m = copter.autopilot.motion.position[0]
    assert copter.command(176, 1, BRAKE) == ACCEPTED
    copter.fly(10)
    assert copter.autopilot.motion.groundspeed_m_s < 0.1
    assert 0 < copter.autopilot.motion.position[0] - north_m < 25


def test_a_landing_slows_down_near_the_ground_and_disarms_in_land_mode(copter: Any) -> None:
    copter.take_off(20)
    assert copter.command(21) == ACCEPTED
    copter.fly_until(lambda: copter.up_m < 15)
    assert copter.autopilot.motion.velocity[2] == pytest.approx(-1.5, abs=0.1)
    assert copter.autopilot.landed_state == mavlink.MAV_LANDED_STATE_LANDING
    copter.fly_until(lambda: copter.up_m < 3)
    assert copter.autopilot.motion.velocity[2] == pytest.approx(-0.5, abs=0.05)
    copter.fly_until(lambda: copter.autopilot.landed)
    copter.fly(0.1)
    assert (copter.autopilot.armed, copter.mode) == (False, "LAND")


def test_a_return_climbs_waits_above_home_lands_and_stays_in_rtl(copter: Any) -> None:
    copter.take_off()
    copter.go(40, 0, 10)
    copter.fly(25)
    assert copter.command(176, 1, RTL) == ACCEPTED
    copter.fly_until(lambda: copter.autopilot.motion.position[0] < 30)
    assert copter.up_m == pytest.approx(15, abs=0.6)
    copter.fly_until(lambda: copter.autopilot.motion.position[0] < 1)
    assert copter.fly_until(lambda: copter.autopilot.landed_state == mavlink.MAV_LANDED_STATE_LANDING) > 4
    copter.fly_until(lambda: not copter.autopilot.armed)
    assert copter.autopilot.motion.position == pytest.approx([0, 0, 0], abs=0.5)
    assert copter.mode == "RTL"


@pytest.mark.parametrize(("away_m", "height_m"), [(0, 12.5), (4.5, 13.5), (30, 15)])
def test_a_return_from_near_climbs_less(copter: Any, away_m: float, height_m: float) -> None:
    copter.take_off()
    copter.go(away_m, 0, 10)
    copter.fly(20)
    copter.command(176, 1, RTL)
    highest_m = 0.0
    while copter.autopilot.armed:
        copter.fly(0.1)
        highest_m = max(highest_m, copter.up_m)
    assert highest_m == pytest.approx(height_m, abs=0.6)


def test_a_velocity_is_followed_and_three_seconds_of_silence_end_it(copter: Any) -> None:
    copter.take_off()
    for _ in range(60):
        copter.push(3, 0, 0)
        copter.fly(0.1)
    assert copter.autopilot.motion.velocity[0] == pytest.approx(3, abs=0.1)
    copter.fly(2.5)
    assert copter.autopilot.motion.velocity[0] == pytest.approx(3, abs=0.1)
    copter.fly(4)
    assert copter.autopilot.motion.groundspeed_m_s < 0.1
    assert copter.mode == "GUIDED"


def test_without_sticks_loiter_descends_and_stabilize_falls(copter: Any) -> None:
    copter.take_off(20)
    copter.command(176, 1, LOITER)
    copter.fly(4)
    assert copter.autopilot.motion.velocity[2] == pytest.approx(-2.5, abs=0.1)
    copter.command(176, 1, 0)
    copter.fly_until(lambda: copter.up_m == 0, limit_s=3)


def test_the_side_channel_puts_it_back_and_a_pilots_mode_ends_what_it_did(copter: Any) -> None:
    copter.vehicle.control({"set": {"altitude_m": 20}})
    copter.fly(5)
    assert (copter.up_m, copter.mode, copter.autopilot.armed) == (pytest.approx(20), "GUIDED", True)
    copter.go(100, 0, 20)
    copter.fly(5)
    _, outputs = copter.vehicle.control({"set": {"mode": "brake"}})
    assert [o.message.custom_mode for o in outputs if hasattr(o, "message")] == [BRAKE], "a heartbeat tells it at once"
    copter.fly(8)
    assert copter.autopilot.motion.groundspeed_m_s < 0.1
