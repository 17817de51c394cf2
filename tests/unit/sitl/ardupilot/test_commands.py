"""ArduCopter's rules for commands and set-points, with their results and reasons."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.ardupilot.telemetry import CopterTelemetry
from sitl.errors import SitlError
from sitl.streams import number

NAN = float("nan")
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
ARM, TAKEOFF, LAND, REPOSITION, SET_MODE = 400, 22, 21, 192, 176
ALT_HOLD, LOITER, POSHOLD = 2, 5, 16
AUTO, GUIDED, RTL, LAND_MODE, BRAKE, STABILIZE = 3, 4, 6, 9, 17, 0
FORCE, FORCE_ARMING = 21196, 2989


@pytest.mark.parametrize("mode", [RTL, LAND_MODE, BRAKE])
def test_arming_is_refused_in_a_mode_that_it_could_not_take_off_in(copter: Any, mode: int) -> None:
    assert copter.command(SET_MODE, 1, mode) == ACCEPTED
    assert copter.command(ARM, 1) == FAILED
    assert "not armable" in copter.texts()[-1]
    assert copter.command(SET_MODE, 1, GUIDED) == ACCEPTED
    assert copter.command(ARM, 1) == ACCEPTED
    assert copter.command(ARM, 1) == ACCEPTED, "again"


def test_arming_without_a_position_is_refused_with_a_reason_and_told_in_its_health(copter: Any) -> None:
    def would_arm() -> bool:
        status = copter.vehicle.telemetry.make("SYS_STATUS")
        assert status.onboard_control_sensors_present & mavlink.MAV_SYS_STATUS_PREARM_CHECK
        return bool(status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)

    assert would_arm()
    copter.vehicle.control({"set": {"healthy": False}})
    assert not would_arm()
    assert copter.command(ARM, 1) == FAILED
    assert copter.texts()[-1].startswith("Arm: ")
    assert copter.command(ARM, 1, FORCE_ARMING) == ACCEPTED


def test_disarming_in_the_air_must_be_forced(copter: Any) -> None:
    copter.take_off()
    assert copter.command(ARM, 0) == FAILED
    assert copter.command(ARM, 0, FORCE) == ACCEPTED
    copter.fly_until(lambda: copter.autopilot.landed)
    assert copter.command(ARM, 2) == UNSUPPORTED


def test_a_takeoff_is_for_the_ground_armed_in_guided(copter: Any) -> None:
    up = [0.0] * 6
    assert copter.command(TAKEOFF, *up, 5) == FAILED, "disarmed"
    copter.command(ARM, 1)
    copter.fly(2)
    assert copter.up_m == 0, "what was refused is not flown after arming"
    copter.command(SET_MODE, 1, BRAKE)
    assert copter.command(TAKEOFF, *up, 5) == FAILED, "in another mode"
    copter.command(SET_MODE, 1, GUIDED)
    assert copter.command(TAKEOFF, *up, -1) == FAILED, "downwards"
    assert copter.command(TAKEOFF, *up, 5) == ACCEPTED
    copter.fly(8)
    assert copter.command(TAKEOFF, *up, 12) == FAILED, "in the air"


def test_a_goto_on_the_ground_is_accepted_and_not_flown(copter: Any) -> None:
    assert copter.go(20, 0, 10) == ACCEPTED
    copter.command(ARM, 1)
    assert copter.go(20, 0, 10) == ACCEPTED
    copter.push(0, 0, -2)
    copter.fly(5)
    assert copter.autopilot.motion.position == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    "where", [{"x": 0, "y": 0}, {"x": 2**31 - 1, "y": 2**31 - 1}, {"x": 473_977_420, "y": 85_455_940, "z": NAN}]
)
def test_a_goto_to_nowhere_is_denied(copter: Any, where: dict[str, Any]) -> None:
    copter.take_off()
    assert copter.command_int(REPOSITION, -1, 1, **where) == DENIED


def test_a_goto_has_to_be_allowed_to_change_the_mode(copter: Any) -> None:
    copter.take_off()
    copter.command(SET_MODE, 1, BRAKE)
    place = {"x": 473_978_420, "y": 85_455_940, "z": 500}
    assert copter.command_int(REPOSITION, -1, 0, **place) == DENIED
    assert copter.command_int(REPOSITION, -1, 1, **place) == ACCEPTED
    assert copter.mode == "GUIDED"


def test_modes_and_their_refusals(copter: Any) -> None:
    assert copter.command(SET_MODE, 1, STABILIZE) == ACCEPTED
    assert copter.command(SET_MODE, 1, 99) == FAILED
    assert copter.texts() == ["No such mode 99"]
    assert copter.command(SET_MODE, 0, GUIDED) == copter.command(SET_MODE, 1, NAN) == DENIED
    copter.tell(mavlink.MAVLink_set_mode_message(1, 1, GUIDED))
    copter.take_off()
    assert copter.command(SET_MODE, 1, AUTO) == FAILED
    assert copter.texts()[-1].startswith("Mode change to AUTO failed")
    assert copter.mode == "GUIDED"


def test_set_points_are_followed_in_guided_alone(copter: Any) -> None:
    copter.take_off()
    copter.command(SET_MODE, 1, BRAKE)
    copter.push(5, 0, 0)
    copter.fly(2)
    assert copter.autopilot.motion.groundspeed_m_s == 0
    copter.command(SET_MODE, 1, GUIDED)
    copter.tell(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0, [1, 0, 0, 0], 0, 0, 0, 1.0))
    copter.fly(2)
    assert copter.autopilot.motion.velocity[2] > 1


def test_a_ping_is_not_answered(copter: Any) -> None:
    assert copter.tell(mavlink.MAVLink_ping_message(123, 7, 0, 0)) == []


def test_every_message_that_it_has_can_be_asked_for(copter: Any) -> None:
    copter.take_off()
    for name in CopterTelemetry.makers:
        assert copter.command(512, number(name)) == ACCEPTED, name
        assert copter.sent(name), name


def test_a_heartbeat_is_a_quadrotors_with_ardupilot(copter: Any) -> None:
    heartbeat = copter.heartbeat
    assert (heartbeat.type, heartbeat.autopilot) == (mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
    assert (heartbeat.custom_mode, heartbeat.system_status) == (GUIDED, mavlink.MAV_STATE_STANDBY)
    copter.take_off()
    assert copter.heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert copter.heartbeat.system_status == mavlink.MAV_STATE_ACTIVE


def test_the_fleets_parameters_have_counterparts(make_copter: Any) -> None:
    copter = make_copter(MPC_XY_CRUISE=14, RTL_RETURN_ALT=10, MPC_XY_VEL_MAX=14)
    (speed,) = copter.tell(mavlink.MAVLink_param_request_read_message(1, 1, b"WPNAV_SPEED", -1))
    assert (speed.param_value, speed.param_type) == (1400, mavlink.MAV_PARAM_TYPE_REAL32)
    assert speed.param_index == 65_535, "asked by its name it has no place in the list"
    (height,) = copter.tell(mavlink.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2000.0, mavlink.MAV_PARAM_TYPE_REAL32))
    assert (height.param_value, copter.autopilot.parameters["RTL_ALT"]) == (2000.0, 2000)
    with pytest.raises(SitlError, match=r"drones\.1\.parameters\.NAV_ACC_RAD: ArduCopter has no such parameter"):
        make_copter(NAV_ACC_RAD=5.0)
    with pytest.raises(SitlError, match="parameter RTL_ALT: expected 30 to 300000, got 0"):
        make_copter(RTL_RETURN_ALT=0)
