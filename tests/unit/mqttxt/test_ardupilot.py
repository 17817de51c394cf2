"""ArduCopter: what its messages mean, and how commands are said to it (section 5)."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.effects import Transmit
from mqttxt.drone.executor import Executor
from mqttxt.drone.mavlink.ardupilot import ArduCopter
from mqttxt.drone.mavlink.plans import CommandPlan
from mqttxt.drone.mavlink.raw import Limits
from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.protocol.commands import (
    Arm,
    Command,
    Disarm,
    Goto,
    Hold,
    Land,
    Mavlink,
    Offboard,
    Return,
    SetParameter,
    Takeoff,
    Velocity,
)
from mqttxt.protocol.messages import Word
from mqttxt.protocol.states import FlightMode, FlightModeName, Health, MaxGroundspeed
from tests.simulation.workbench import Bench, said, set_points, written
from tests.simulation.world import ack, from_autopilot, home, landed, position
from tests.simulation.world import heartbeat as px4_heartbeat

STABILIZE, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 4, 5, 6, 9, 17
SET_MODE, ARM, TAKEOFF, REPOSITION = 176, 400, 22, 192
CAMERA = mavlink.MAV_COMP_ID_CAMERA
COMMANDS = (
    Arm(),
    Disarm(),
    Takeoff(10.0),
    Land(),
    Goto(47.398, 8.5456, 12.5),
    Hold(),
    Return(),
    Offboard(5.0, velocity=Velocity(1.0, 0.0, 0.0)),
)


def heartbeat(mode: int = GUIDED, armed: bool = False, kind: int = mavlink.MAV_TYPE_QUADROTOR) -> Any:
    base = 81 | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    return from_autopilot(
        mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base, mode, 3, 3)
    )


def vehicle(*messages: Any) -> Vehicle:
    made = Vehicle(1)
    for message in messages:
        made.update(message, 0)
    return made


def flying(mode: int = GUIDED) -> Vehicle:
    return vehicle(heartbeat(mode, armed=True), home(), position(10.0), landed(2))


def on_ground(mode: int = GUIDED, armed: bool = False) -> Vehicle:
    return vehicle(heartbeat(mode, armed), home(), position(), landed(1))


def plan(command: Command, seen: Vehicle) -> CommandPlan:
    return seen.autopilot.plan(command, seen, 0)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_no_field_of_any_command_is_nan(command: Command) -> None:
    """ArduCopter ends with a floating point exception on one in NAV_TAKEOFF."""
    seen = on_ground(armed=True) if isinstance(command, Takeoff) else flying()
    message = plan(command, seen).message
    values = [getattr(message, name) for name in message.fieldnames]
    assert not [value for value in values if isinstance(value, float) and math.isnan(value)]


def test_a_null_among_a_raw_commands_parameters_is_never_written_as_nan() -> None:
    """ArduCopter ends with a floating point exception on one in CONDITION_YAW; what is for a camera it passes on."""
    bench = Bench(heartbeat(armed=True), home(), position(10.0), landed(2))
    bench.executor = Executor(bench.vehicle, Limits(components=frozenset((CAMERA,))))
    given = (90.0, None, 1.0, 0.0, 0.0, 0.0, 0.0)
    out = bench.start(1, Mavlink(mavlink.MAV_CMD_CONDITION_YAW, given))
    assert (written(out), said(out)) == ([], [(1, Word.DENIED, "null_param")])
    assert written(bench.start(2, Mavlink(mavlink.MAV_CMD_CONDITION_YAW, (90.0, *[0.0] * 6)))) == [115]
    assert written(bench.start(3, Mavlink(mavlink.MAV_CMD_DO_DIGICAM_CONTROL, given, CAMERA))) == [203]


def test_a_takeoff_is_in_guided_and_names_the_height_above_home() -> None:
    planned = plan(Takeoff(10.0), on_ground(STABILIZE, armed=True))
    assert planned.first_mode is FlightModeName.GUIDED
    message = planned.message
    assert (message.get_type(), message.command, message.param7) == ("COMMAND_LONG", TAKEOFF, 10.0)


@pytest.mark.parametrize(
    ("mode", "armed", "first"),
    [
        (LAND, False, FlightModeName.GUIDED),
        (RTL, False, FlightModeName.GUIDED),
        (BRAKE, False, FlightModeName.GUIDED),
        (STABILIZE, False, None),
        (LOITER, False, None),
        (GUIDED, False, None),
        (LAND, True, None),
    ],
)
def test_arming_leaves_a_mode_only_where_it_would_be_refused(
    mode: int, armed: bool, first: FlightModeName | None
) -> None:
    assert plan(Arm(), on_ground(mode, armed)).first_mode is first


def test_goto_is_a_reposition_into_guided() -> None:
    message = plan(Goto(47.5, -8.25, 12.5), flying(BRAKE)).message
    assert (message.get_type(), message.command, message.frame) == ("COMMAND_INT", REPOSITION, mavlink.MAV_FRAME_GLOBAL)
    assert (message.x, message.y, message.z) == (475_000_000, -82_500_000, 500.5)
    assert message.param2 == mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE


@pytest.mark.parametrize(
    ("command", "mode"), [(Hold(), BRAKE), (Return(), RTL), (Offboard(5.0, velocity=Velocity(1, 0, 0)), GUIDED)]
)
def test_hold_return_and_offboard_are_modes(command: Command, mode: int) -> None:
    message = plan(command, flying()).message
    assert (message.command, message.param1, message.param2, message.param3) == (SET_MODE, 1.0, float(mode), 0.0)


@pytest.mark.parametrize(
    ("number", "name"),
    [
        (0, FlightModeName.STABILIZED),
        (3, FlightModeName.MISSION),
        (4, FlightModeName.GUIDED),
        (6, FlightModeName.RETURN),
        (9, FlightModeName.LAND),
        (17, FlightModeName.BRAKE),
        (28, FlightModeName.TURTLE),
        (8, FlightModeName.UNKNOWN),
        (99, FlightModeName.UNKNOWN),
    ],
)
def test_modes_have_the_names_of_their_numbers(number: int, name: FlightModeName) -> None:
    assert vehicle(heartbeat(number)).seen(FlightMode) == FlightMode(name)


@pytest.mark.parametrize("kind", [mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_TYPE_GCS])
def test_ardupilots_other_vehicles_are_of_no_known_kind(kind: int) -> None:
    """A plane's mode 4 is not GUIDED."""
    seen = vehicle(heartbeat(kind=kind))
    assert seen.seen(FlightMode) is None
    assert not seen.is_alive(0)


def test_the_first_heartbeat_decides() -> None:
    seen = vehicle(heartbeat(BRAKE), px4_heartbeat())
    assert isinstance(seen.autopilot, ArduCopter)
    assert seen.seen(FlightMode) == FlightMode(FlightModeName.BRAKE)


PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK


@pytest.mark.parametrize(
    ("bits", "health"),
    [
        ((PREARM | 1, PREARM | 1, PREARM | 1), Health(True, 0)),
        ((PREARM | 1, PREARM | 1, 1), Health(False, PREARM)),
        ((PREARM | 5, PREARM | 1, PREARM), Health(True, 1)),
        ((1, 1, 1), Health(False, 0)),
    ],
)
def test_it_is_armable_where_its_prearm_check_is_there_and_healthy(bits: tuple[int, int, int], health: Health) -> None:
    status = mavlink.MAVLink_sys_status_message(*bits, *[0] * 10)
    assert vehicle(heartbeat(), from_autopilot(status)).seen(Health) == health


@pytest.mark.parametrize(("name", "value"), [("WPNAV_SPEED", 1000.0), ("WP_SPD", 10.0)])
def test_its_speed_is_a_parameter_of_either_name(name: str, value: float) -> None:
    told = from_autopilot(mavlink.MAVLink_param_value_message(name.encode(), value, 9, 1, 0))
    seen = vehicle(heartbeat(), told)
    assert (seen.seen(MaxGroundspeed), seen.cruise_m_s) == (MaxGroundspeed(10.0), 10.0)


def test_a_takeoff_after_a_landing_enters_guided_before_it_is_said() -> None:
    bench = Bench(heartbeat(LAND, armed=True), home(), position(), landed(1))
    assert written(bench.start(1, Takeoff(10.0))) == [SET_MODE]
    bench.hear(heartbeat(GUIDED, armed=True))
    assert written(bench.until(200)) == [TAKEOFF]


def test_a_pilots_mode_ends_a_goto() -> None:
    bench = Bench(heartbeat(armed=True), home(), position(10.0), landed(2))
    assert written(bench.start(1, Goto(47.5, 8.0, 10.0))) == [REPOSITION]
    assert said(bench.hear(ack(REPOSITION))) == [(1, Word.ACCEPTED, None)]
    assert said(bench.hear(heartbeat(armed=True))) == []
    assert said(bench.hear(heartbeat(LOITER, armed=True))) == [(1, Word.FAILED, "mode_changed")]


def test_what_it_refuses_is_denied_with_what_it_tells_people() -> None:
    bench = Bench(heartbeat(), home(), position(), landed(1))
    text = mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, b"Arm: Need Position Estimate")
    bench.hear(from_autopilot(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, b"something older")))
    bench.start(1, Arm())
    bench.hear(from_autopilot(text))
    bench.hear(from_autopilot(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_INFO, b"nothing that matters")))
    refused = bench.hear(ack(ARM, mavlink.MAV_RESULT_FAILED))
    assert said(refused) == [(1, Word.DENIED, "autopilot: Arm: Need Position Estimate")]


def test_the_words_that_it_tells_behind_its_refusal_are_waited_for() -> None:
    bench = Bench(heartbeat(), home(), position(), landed(1))
    bench.start(1, Arm())
    text = mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, b"Arm: LAND mode not armable")
    assert said(bench.hear(ack(ARM, mavlink.MAV_RESULT_FAILED))) == []
    assert said(bench.hear(from_autopilot(text))) == [(1, Word.DENIED, "autopilot: Arm: LAND mode not armable")]
    assert bench.until(5000) == [], "nothing is said or written again"


def test_a_refusal_without_words_is_denied_too() -> None:
    bench = Bench(heartbeat(), home(), position(), landed(1))
    bench.hear(from_autopilot(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, b"something older")))
    bench.start(1, Arm())
    assert said(bench.hear(ack(ARM, mavlink.MAV_RESULT_FAILED))) == []
    assert said(bench.until(100)) == []
    assert said(bench.until(200)) == [(1, Word.DENIED, "autopilot")]


def test_a_newer_command_does_not_wait_for_the_words_of_a_refused_one() -> None:
    bench = Bench(heartbeat(armed=True), home(), position(10.0), landed(2))
    bench.start(1, Goto(47.5, 8.0, 10.0))
    bench.hear(ack(REPOSITION, mavlink.MAV_RESULT_FAILED))
    assert written(bench.start(2, Land())) == [mavlink.MAV_CMD_NAV_LAND]
    assert said(bench.hear(ack(mavlink.MAV_CMD_NAV_LAND))) == [(2, Word.ACCEPTED, None)]
    assert said(bench.until(200)) == [(1, Word.DENIED, "autopilot")]


def test_a_velocity_needs_no_set_points_before_its_mode_and_ends_in_brake() -> None:
    bench = Bench(heartbeat(armed=True), home(), position(10.0), landed(2))
    bench.executor.lease.until_ms = bench.executor.lease.offboard_until_ms = 60_000
    out = bench.start(1, Offboard(0.5, velocity=Velocity(1.0, 0.0, 0.0)))
    assert written(out) == [SET_MODE]
    assert set_points(out) == []
    out = bench.hear(ack(SET_MODE), heartbeat(armed=True)) + bench.until(400)
    assert said(out) == [(1, Word.ACCEPTED, None)]
    assert len(set_points(out)) >= 4
    out = bench.until(1000)
    assert {message.param2 for message in modes(out)} == {float(BRAKE)}
    assert said(bench.hear(heartbeat(BRAKE, armed=True))) == [(1, Word.COMPLETED, None)]


def test_what_runs_in_guided_does_not_stand_in_the_way_of_set_points() -> None:
    """Of its mode alone nobody can tell whether somebody else's set-points are followed."""
    bench = Bench(heartbeat(armed=True), home(), position(10.0), landed(2))
    bench.executor.lease.until_ms = 60_000
    assert said(bench.start(1, Offboard(1.0, velocity=Velocity(1.0, 0.0, 0.0)))) == []


def modes(outputs: list[Any]) -> list[Any]:
    return [o.message for o in outputs if isinstance(o, Transmit) and getattr(o.message, "command", 0) == SET_MODE]


def test_a_documented_range_holds_for_any_case_of_a_name() -> None:
    """ArduPilot finds a parameter by its name in any case, and answers with the name that it was asked for."""
    bench = Bench(heartbeat(), home(), position(), landed(1))
    bench.executor = Executor(bench.vehicle, Limits(ranges={"RTL_ALT": (30.0, 300_000.0)}))
    bench.start(1, SetParameter("rtl_alt", 1e6))
    value = mavlink.MAVLink_param_value_message(b"rtl_alt", 1500.0, mavlink.MAV_PARAM_TYPE_INT32, 1, 0)
    out = bench.hear(from_autopilot(value))
    assert said(out) == [(1, Word.DENIED, "out_of_range, 30 to 300000")]
