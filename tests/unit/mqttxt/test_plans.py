"""How commands are said in MAVLink (section 5)."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mqttxt.drone.mavlink.plans import CannotExecute, CommandPlan
from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.protocol.commands import Arm, Command, Disarm, Goto, Hold, Land, Return, Takeoff, haversine_m
from tests.simulation.world import heartbeat, home, landed, position


def vehicle(*messages: Any) -> Vehicle:
    made = Vehicle(3)
    for message in messages:
        message._header.srcSystem = 3
        made.update(message, 0)
    return made


def plan(command: Command, seen: Vehicle) -> CommandPlan:
    return seen.autopilot.plan(command, seen, 0)


READY = (heartbeat(), home(), position(), landed(1))


@pytest.mark.parametrize(("command", "param1"), [(Arm(), 1.0), (Disarm(), 0.0)])
def test_arming_is_never_forced(command: Arm | Disarm, param1: float) -> None:
    message = plan(command, vehicle(heartbeat())).message
    assert (message.command, message.param1, message.param2) == (400, param1, 0.0)
    assert (message.target_system, message.target_component) == (3, 1)


def test_a_takeoff_names_metres_above_home_and_changes_no_parameter() -> None:
    message = plan(Takeoff(altitude_m=10.0), vehicle(*READY)).message
    assert (message.get_type(), message.command, message.param7) == ("COMMAND_LONG", 22, 498.0)
    assert math.isnan(message.param5)


def test_goto_is_a_command_int_with_a_global_frame() -> None:
    message = plan(Goto(47.5, -8.25, 12.5), vehicle(*READY)).message
    assert (message.get_type(), message.command, message.frame) == ("COMMAND_INT", 192, 5)
    assert (message.x, message.y, message.z) == (475_000_000, -82_500_000, 500.5)


@pytest.mark.parametrize(("command", "sub"), [(Hold(), 3), (Return(), 5)])
def test_hold_and_return_are_modes(command: Hold | Return, sub: int) -> None:
    message = plan(command, vehicle(heartbeat())).message
    assert (message.command, message.param1, message.param2, message.param3) == (176, 1.0, 4.0, float(sub))


def test_nothing_is_said_to_an_autopilot_of_an_unknown_kind() -> None:
    with pytest.raises(CannotExecute, match="no_autopilot"):
        plan(Arm(), vehicle(home(), position()))


@pytest.mark.parametrize("command", [Takeoff(altitude_m=10.0), Goto(47.5, 8.0, 10.0)])
def test_home_unknown_is_a_reason(command: Takeoff | Goto) -> None:
    with pytest.raises(CannotExecute, match="home_unknown"):
        plan(command, vehicle(heartbeat()))


def test_land_is_done_when_landed_and_disarmed_both_newly_told() -> None:
    seen = vehicle(*READY)
    planned, after = plan(Land(), seen), seen.number
    assert not planned.effect(seen, after)
    for message in (landed(1), heartbeat(armed=False)):
        message._header.srcSystem = 3
        assert not planned.effect(seen, after)
        seen.update(message, 0)
    assert planned.effect(seen, after)


@pytest.mark.parametrize(
    ("north_1e7", "altitude_m", "arrived"), [(170, 10.0, True), (200, 10.0, False), (0, 8.9, False)]
)
def test_goto_is_done_within_two_metres_and_one_of_altitude(north_1e7: int, altitude_m: float, arrived: bool) -> None:
    seen = vehicle(*READY)
    planned, after = plan(Goto(47.397742, 8.545594, 10.0), seen), seen.number
    there = position(altitude_m, north_1e7)
    there._header.srcSystem = 3
    seen.update(there, 0)
    assert planned.effect(seen, after) is arrived


def test_distances_are_of_a_sphere_of_6371_km() -> None:
    assert haversine_m(0, 0, 0, 180) == pytest.approx(math.pi * 6_371_000)
    assert haversine_m(47, 8, 48, 8) == pytest.approx(math.pi * 6_371_000 / 180)


ANY_NUMBER = st.floats(-1e9, 1e9)


@given(ANY_NUMBER, ANY_NUMBER, ANY_NUMBER, ANY_NUMBER)
@example(104.4, -28.9, 47.4, 8.5)
@example(1.0, 0.0, -1.0, 180.0)
@example(89.99999999, 0.1, -89.99999999, -179.9)
def test_any_two_positions_have_a_distance(lat_1: float, lon_1: float, lat_2: float, lon_2: float) -> None:
    assert 0 <= haversine_m(lat_1, lon_1, lat_2, lon_2) <= math.pi * 6_371_000 * 1.000001
