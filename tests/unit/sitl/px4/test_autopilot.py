"""Arming, modes and whole flights, in simulated time."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.px4.modes import Mode

NAN = float("nan")


def test_it_disarms_when_nobody_takes_off(make_drone: Any) -> None:
    drone = make_drone(COM_DISARM_PRFLT=10)
    drone.fly(30)
    drone.command(400, 1)
    assert drone.fly_until(lambda: not drone.autopilot.armed) == pytest.approx(10, abs=0.2)


def test_zero_turns_disarming_by_itself_off(make_drone: Any) -> None:
    drone = make_drone(COM_DISARM_PRFLT=-1)
    drone.command(400, 1)
    drone.fly(100)
    assert drone.autopilot.armed


def test_a_takeoff_climbs_at_its_speed_and_ends_in_hold(drone: Any) -> None:
    drone.command(400, 1)
    drone.command(22, *[NAN] * 6, 498.0)
    drone.fly_until(lambda: drone.up_m > 5)
    assert drone.autopilot.motion.velocity[2] == pytest.approx(1.5, abs=0.05)
    assert drone.autopilot.landed_state == mavlink.MAV_LANDED_STATE_TAKEOFF
    drone.fly_until(lambda: drone.mode == "HOLD")
    assert drone.autopilot.landed_state == mavlink.MAV_LANDED_STATE_IN_AIR
    drone.fly(10)
    assert drone.up_m == pytest.approx(10, abs=0.05)


def test_hold_in_cruise_flies_on_and_a_reposition_to_nowhere_brakes(drone: Any) -> None:
    drone.take_off()
    drone.reposition(100, 0)
    drone.fly(8)
    assert drone.command(176, 1, 4, 3) == 0
    drone.fly(2)
    assert drone.autopilot.motion.velocity[0] > 4, "a goto is hold for PX4: hold changes nothing"
    stop = {"x": 2**31 - 1, "y": 2**31 - 1, "z": NAN}
    assert drone.command_int(192, -1, 1, **stop) == 0
    slowest = 0.0
    for _ in range(500):
        drone.fly(0.02)
        slowest = min(slowest, drone.autopilot.motion.velocity[0])
    assert slowest > -0.5
    assert drone.autopilot.motion.groundspeed_m_s < 0.05


def test_landing_slows_down_near_the_ground(drone: Any) -> None:
    drone.take_off(20)
    drone.command(21)
    drone.fly_until(lambda: drone.up_m < 12)
    assert drone.autopilot.motion.velocity[2] == pytest.approx(-1.5, abs=0.05)
    drone.fly_until(lambda: drone.up_m < 3)
    assert drone.autopilot.motion.velocity[2] == pytest.approx(-0.7, abs=0.05)
    assert drone.autopilot.landed_state == mavlink.MAV_LANDED_STATE_LANDING


def test_return_climbs_flies_home_lands_and_disarms(make_drone: Any) -> None:
    drone = make_drone(RTL_RETURN_ALT=20)
    drone.take_off()
    drone.reposition(60, 0)
    drone.fly_until(lambda: drone.autopilot.motion.position[0] > 59)
    drone.command(176, 1, 4, 5)
    drone.fly_until(lambda: drone.autopilot.motion.position[0] < 55)
    assert drone.up_m == pytest.approx(20, abs=0.9), "it climbs before it flies"
    drone.fly_until(lambda: not drone.autopilot.armed)
    assert drone.autopilot.motion.position == pytest.approx([0, 0, 0], abs=0.5)


def test_return_never_descends_to_its_height(make_drone: Any) -> None:
    drone = make_drone(RTL_RETURN_ALT=5)
    drone.take_off(15)
    drone.reposition(30, 0)
    drone.fly(15)
    drone.command(176, 1, 4, 5)
    drone.fly(3)
    assert drone.up_m == pytest.approx(15, abs=0.3)


def test_return_at_home_lands_at_once(drone: Any) -> None:
    drone.take_off(5)
    drone.command(176, 1, 4, 5)
    drone.fly_until(lambda: drone.autopilot.landed_state == mavlink.MAV_LANDED_STATE_LANDING, limit_s=2)
    drone.fly_until(lambda: drone.autopilot.landed, limit_s=20)
    drone.fly_until(lambda: not drone.autopilot.armed, limit_s=3)
    assert drone.mode == "HOLD", "a return that is over gives way to hold"


def test_a_return_from_near_home_stays_within_the_cone(make_drone: Any) -> None:
    """Farther than NAV_ACC_RAD and nearer than RTL_MIN_DIST it climbs no higher than RTL_CONE_ANG allows."""
    drone = make_drone()
    drone.take_off(3)
    drone.reposition(8, 0)
    drone.fly(15)
    drone.command(176, 1, 4, 5)
    highest = 0.0
    while drone.autopilot.armed:
        drone.fly(0.1)
        highest = max(highest, drone.up_m)
    assert highest == pytest.approx(8, abs=1)


def test_it_flies_again(drone: Any) -> None:
    for _ in range(2):
        drone.take_off()
        drone.command(21)
        drone.fly_until(lambda: not drone.autopilot.armed)
    assert drone.events().count("took_off") == 2


def test_put_back_into_a_starting_state(drone: Any) -> None:
    drone.fly(100)
    drone.autopilot.put_back(altitude_m=0, armed=True)
    drone.fly(9)
    assert drone.autopilot.armed, "disarming by itself counts from now"
    drone.autopilot.put_back(altitude_m=10, armed=False)
    assert drone.autopilot.armed
    drone.fly(20)
    assert drone.up_m == pytest.approx(10, abs=0.01)
    assert drone.autopilot.mode is Mode.HOLD


def test_the_same_inputs_at_the_same_times_give_the_same_flight(make_drone: Any) -> None:
    def flown() -> tuple[Any, bytes]:
        drone = make_drone()
        drone.take_off()
        sent = b"".join(m.pack(mavlink.MAVLink(None)) for m in drone.vehicle.streamed(0, drone.autopilot.now_s))
        return drone.autopilot.motion, sent

    assert flown() == flown()


def test_time_in_one_leap_is_time_in_small_steps(make_drone: Any) -> None:
    leap, steps = make_drone(), make_drone()
    for drone in (leap, steps):
        drone.command(400, 1)
        drone.command(22, *[NAN] * 7)
    leap.vehicle.advance(8.0)
    for tick in range(1, 801):
        steps.vehicle.advance(tick * 0.01)
    assert leap.autopilot.motion == steps.autopilot.motion
    assert leap.up_m > 1
