"""PX4's rules for commands and set-points, with their results and reasons."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from sitl.fleet import DroneConfig
from sitl.px4.streams import RATES_HZ
from sitl.vehicle import Vehicle

NAN = float("nan")
ACCEPTED, REJECTED, UNSUPPORTED = 0, 1, 3
ARM, TAKEOFF, LAND, SET_MODE = 400, 22, 21, 176
FORCE = 21196


def test_arming_is_told_by_the_next_heartbeat(drone: Any) -> None:
    assert drone.command(ARM, 1) == ACCEPTED
    assert drone.sent("HEARTBEAT") == []
    assert drone.heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert drone.events() == ["command", "armed"]


@pytest.mark.parametrize("mode", [(4, 6), (4, 5), (3, 0), (4, 4), (6, 0)])
def test_arming_is_refused_in_a_mode_that_it_could_not_take_off_in(drone: Any, mode: tuple[int, int]) -> None:
    """Disarmed any mode can be chosen, but land, return, and those without sticks, mission or set-points."""
    assert drone.command(SET_MODE, 1, *mode) == ACCEPTED
    assert drone.command(ARM, 1) == REJECTED
    assert drone.command(SET_MODE, 1, 4, 3) == ACCEPTED
    assert drone.command(ARM, 1) == ACCEPTED


@pytest.mark.parametrize("wanted", [{"healthy": False}, {"battery_pct": 3}])
def test_arming_is_refused_with_a_reason(drone: Any, wanted: dict[str, Any]) -> None:
    drone.vehicle.control({"set": wanted})
    assert drone.command(ARM, 1) == REJECTED
    first, last = (message.text for message in drone.sent("STATUSTEXT")[-2:])
    assert (len(first), last) == (50, "t\t"), "in two parts, as PX4 sends it"
    assert drone.texts()[-1] == "Arming denied: Resolve system health failures first"
    assert drone.command(ARM, 1, FORCE) == ACCEPTED


@pytest.mark.parametrize("number", [2, -1, NAN, math.inf])
def test_arming_by_any_other_number_is_not_answered(drone: Any, number: float) -> None:
    assert drone.command(ARM, number) is None
    assert not drone.autopilot.armed


def test_disarming_in_the_air_must_be_forced(drone: Any) -> None:
    drone.take_off()
    assert drone.command(ARM, 0) == REJECTED
    assert drone.texts()[-1] == "Disarming denied: not landed"
    assert drone.command(ARM, 0, FORCE) == ACCEPTED
    assert drone.fly_until(lambda: drone.up_m == 0) < 5, "without motors it falls"
    drone.fly_until(lambda: drone.autopilot.landed)


def test_takeoff_without_a_height_takes_the_parameter(make_drone: Any) -> None:
    drone = make_drone(MIS_TAKEOFF_ALT=7)
    drone.command(ARM, 1)
    assert drone.command(TAKEOFF, *[NAN] * 7) == ACCEPTED
    drone.fly(20)
    assert drone.up_m == pytest.approx(7, abs=0.1)


def test_takeoff_heights_are_above_sea_level(drone: Any) -> None:
    drone.take_off(12)
    assert drone.up_m == pytest.approx(12, abs=0.35)


def test_takeoff_as_command_int_honours_the_frame(drone: Any) -> None:
    drone.command(ARM, 1)
    assert drone.command_int(TAKEOFF, z=6, frame=mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT) == ACCEPTED
    drone.fly(20)
    assert drone.up_m == pytest.approx(6, abs=0.1)


def test_a_takeoff_below_the_drone_does_not_move_it(drone: Any) -> None:
    drone.command(ARM, 1)
    assert drone.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0) == ACCEPTED, "MAVProxy's `takeoff 10`, read as AMSL"
    assert drone.texts()[-1] == "Already higher than takeoff altitude"
    drone.fly(5)
    assert drone.up_m == 0.0


def test_a_takeoff_sent_twice_is_one(drone: Any) -> None:
    drone.command(ARM, 1)
    drone.command(TAKEOFF, *[NAN] * 7)
    drone.fly(1)
    assert drone.command(TAKEOFF, *[NAN] * 7) == ACCEPTED
    drone.fly(15)
    height_m = drone.up_m
    assert drone.command(TAKEOFF, *[NAN] * 7) == ACCEPTED, "in the air too: it never goes down"
    drone.fly(10)
    assert (drone.mode, drone.up_m) == ("HOLD", pytest.approx(height_m, abs=0.1))


def test_land_and_disarm_after_com_disarm_land(drone: Any) -> None:
    drone.take_off()
    assert drone.command(LAND, *[NAN] * 7) == ACCEPTED
    drone.fly_until(lambda: drone.autopilot.landed)
    assert drone.fly_until(lambda: not drone.autopilot.armed) == pytest.approx(2.0, abs=0.2)
    assert drone.mode == "HOLD", "a landing that is over gives way to hold"
    order = [event for event in drone.events() if event not in ("command", "mode")]
    assert order == ["armed", "took_off", "landed", "disarmed"]


def test_a_mode_is_told_in_px4s_numbers(drone: Any) -> None:
    assert drone.command(SET_MODE, 1, 4, 5) == ACCEPTED
    assert drone.heartbeat.custom_mode == 4 << 16 | 5 << 24


@pytest.mark.parametrize("params", [(0, 4, 3), (1, 9, 9), (1, 4, NAN), (NAN, 4, 3)])
def test_modes_that_do_not_exist_are_refused(drone: Any, params: tuple[float, ...]) -> None:
    assert drone.command(SET_MODE, *params) == REJECTED
    assert drone.mode == "HOLD"
    assert drone.texts()


@pytest.mark.parametrize("mode", [(1, 0), (2, 0), (3, 0), (5, 0), (7, 0), (4, 4), (6, 0)])
def test_in_flight_a_mode_without_what_it_needs_is_taken_and_then_refused(drone: Any, mode: tuple[int, int]) -> None:
    """Sticks, a mission, a stream of set-points: PX4 acknowledges twice, and the second answer counts."""
    drone.take_off()
    drone.out.clear()
    assert drone.command(SET_MODE, 1, *mode) == REJECTED
    assert [ack.result for ack in drone.sent("COMMAND_ACK")] == [ACCEPTED, REJECTED]
    assert drone.texts()[-1].startswith("Switching to ")
    assert drone.mode == "HOLD"


def test_others_commands_have_no_answer(drone: Any) -> None:
    assert drone.command(ARM, 1, system=2) is None
    assert drone.command(ARM, 1, component=100) is None
    assert drone.command(ARM, 1, system=0, component=0) == ACCEPTED, "MAVProxy's disarm targets component 0"


def test_every_command_is_an_event_with_its_parameters(drone: Any) -> None:
    drone.command(TAKEOFF, 1, 2, 3, NAN, 5, 6, 7)
    drone.command(512, 242)
    events = [output.detail for output in drone.out if hasattr(output, "detail")]
    assert events[0] == {"command": 22, "params": [1, 2, 3, None, 5, 6, 7], "from": 245}
    assert events[-1]["command"] == 512


def test_an_offboard_velocity_is_flown_until_its_controller_is_silent(drone: Any) -> None:
    drone.take_off()
    drone.tell(_velocity(2.0, 0.0, 0.0))
    assert drone.command(SET_MODE, 1, 6, 0) == ACCEPTED
    for _ in range(50):
        drone.tell(_velocity(2.0, 0.0, -1.0))
        drone.fly(0.1)
    assert drone.autopilot.motion.velocity == pytest.approx([1.72, 0.0, 1.0], abs=0.02), "drag takes some"
    assert drone.fly_until(lambda: drone.mode == "RETURN") == pytest.approx(1.0, abs=0.2)
    assert drone.texts()[-1] == "Failsafe activated: no offboard signal"
    assert drone.heartbeat.system_status == mavlink.MAV_STATE_CRITICAL
    drone.command(SET_MODE, 1, 4, 3)
    assert drone.heartbeat.system_status == mavlink.MAV_STATE_ACTIVE


def test_an_offboard_position_and_a_body_velocity(drone: Any) -> None:
    drone.take_off()
    drone.tell(_set_point((5.0, 5.0, -12.0), (0.0, 0.0, 0.0), mask=0b1111_1111_1000))
    assert drone.autopilot.guidance.set_point.position == (5.0, 5.0, 12.0)
    drone.autopilot.motion.yaw_rad = math.pi / 2
    drone.tell(_set_point((0, 0, 0), (1.0, 0.0, 0.0), mask=0b1111_1100_0111, frame=mavlink.MAV_FRAME_BODY_NED))
    assert drone.autopilot.guidance.set_point.velocity == pytest.approx((0.0, 1.0, 0.0))


def test_an_attitude_is_flown_as_tilt_and_thrust(drone: Any) -> None:
    drone.take_off()
    half = math.radians(-10) / 2
    level_mask = 0
    q = [math.cos(half), 0.0, math.sin(half), 0.0]
    drone.tell(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, level_mask, q, 0, 0, 0, 0.75))
    north, east, up = drone.autopilot.guidance.set_point.velocity
    assert north > 1, "nose down is forward"
    assert east == pytest.approx(0)
    assert up == pytest.approx(1.5)


FLOATS = st.floats(width=32)


@given(st.sampled_from([21, 22, 176, 192, 400, 510, 511, 512, 520, 999]), st.lists(FLOATS, min_size=7, max_size=7))
def test_no_parameter_ends_the_flight(number: int, params: list[float]) -> None:
    vehicle = Vehicle(DroneConfig(1), ["px4-onboard"])
    vehicle.control({"set": {"altitude_m": 10}})
    _tell(vehicle, mavlink.MAVLink_command_long_message(1, 1, number, 0, *params))
    _tell(vehicle, mavlink.MAVLink_command_int_message(1, 1, 0, number, 0, 0, *params[:4], 0, 0, params[6]))
    _assert_flies_on(vehicle)


@given(st.lists(FLOATS, min_size=9, max_size=9), st.integers(0, 0xFFFF), st.sampled_from([1, 8, 21]))
def test_no_set_point_ends_the_flight(values: list[float], mask: int, frame: int) -> None:
    vehicle = Vehicle(DroneConfig(1), ["px4-onboard"])
    vehicle.control({"set": {"altitude_m": 10}})
    _tell(vehicle, _set_point(values[:3], values[3:6], mask=mask, frame=frame))
    _tell(vehicle, mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0))
    _assert_flies_on(vehicle)
    _tell(vehicle, mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask & 0xFF, values[:4], 0, 0, 0, values[8]))
    _assert_flies_on(vehicle)


def _tell(vehicle: Vehicle, message: Any) -> None:
    packed = message.pack(mavlink.MAVLink(None, 245, 190))
    for one in mavlink.MAVLink(None).parse_buffer(packed):
        vehicle.handle(0, one)


def _assert_flies_on(vehicle: Vehicle) -> None:
    """Everything it streams can still be packed, after half a second of flight."""
    vehicle.advance(vehicle.autopilot.now_s + 0.5)
    for name in RATES_HZ:
        message = vehicle.telemetry.make(name)
        if message is not None:
            message.pack(mavlink.MAVLink(None))


def _velocity(north: float, east: float, down: float) -> Any:
    return _set_point((0.0, 0.0, 0.0), (north, east, down), mask=0b1111_1100_0111)


def _set_point(position: Any, velocity: Any, *, mask: int, frame: int = mavlink.MAV_FRAME_LOCAL_NED) -> Any:
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, *position, *velocity, 0, 0, 0, 0, 0
    )
