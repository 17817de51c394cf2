"""What an autopilot's messages tell."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.errors import PayloadError
from mqttxt.protocol.states import (
    Airframe,
    Armed,
    Battery,
    FlightMode,
    FlightModeName,
    Gps,
    GpsFix,
    Groundspeed,
    Heading,
    Health,
    Home,
    Landed,
    LandedState,
    Location,
    MaxGroundspeed,
    Power,
    VelocityNed,
)
from tests.simulation.world import from_autopilot, heartbeat, home, landed, position


def battery(remaining: int, number: int = 0) -> Any:
    return mavlink.MAVLink_battery_status_message(number, 0, 0, 0, [0] * 10, 0, 0, 0, remaining)


def speed(groundspeed: float) -> Any:
    return mavlink.MAVLink_vfr_hud_message(0.0, groundspeed, 0, 0, 0.0, 0.0)


def health(present: int, enabled: int, healthy: int, voltage_mv: int = 65_535, current_ca: int = -1) -> Any:
    return mavlink.MAVLink_sys_status_message(
        present, enabled, healthy, 0, voltage_mv, current_ca, 50, 0, 0, 0, 0, 0, 0
    )


def gps(fix: int, satellites: int, hdop_100: int) -> Any:
    return mavlink.MAVLink_gps_raw_int_message(0, fix, 0, 0, 0, hdop_100, 0, 0, 0, satellites)


def version(number: int) -> Any:
    return mavlink.MAVLink_autopilot_version_message(0, number, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)


def parameter(name: bytes, value: float) -> Any:
    return mavlink.MAVLink_param_value_message(name, value, 9, 1, 0)


@pytest.fixture
def vehicle() -> Vehicle:
    """One whose kind is known."""
    made = Vehicle(1)
    made.update(heartbeat(), 0)
    return made


PX4 = Airframe(mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_TYPE_QUADROTOR)
PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (heartbeat(armed=True, main=4, sub=6), [Armed(True), FlightMode(FlightModeName.LAND), PX4]),
        (position(10.0), [Location(47.397742, 8.545594, 498.0, 10.0), Heading(90.0), VelocityNed(0.0, 0.0, 0.0)]),
        (landed(2), [LandedState(Landed.IN_AIR)]),
        (landed(9), []),
        (home(), [Home(47.397742, 8.545594, 488.0)]),
        (from_autopilot(battery(87)), [Battery(87)]),
        (from_autopilot(battery(-1)), []),
        (from_autopilot(battery(87, number=1)), []),
        (from_autopilot(speed(2.5)), [Groundspeed(2.5)]),
        (from_autopilot(speed(float("nan"))), []),
        (from_autopilot(health(0b11, 0b11, 0b01)), [Health(False, 0b10)]),
        (from_autopilot(health(PREARM | 1, PREARM | 1, PREARM)), [Health(True, 1)]),
        (from_autopilot(health(1, 1, PREARM | 1)), [Health(True, 0)]),  # PX4 says so in the health bits alone
        (from_autopilot(health(1, 1, 1)), [Health(False, 0)]),
        (from_autopilot(health(1, 1, 1, voltage_mv=15_800, current_ca=210)), [Health(False, 0), Power(15.8, 2.1)]),
        (from_autopilot(health(1, 1, 1, voltage_mv=15_800, current_ca=-1)), [Health(False, 0), Power(15.8)]),
        (from_autopilot(gps(3, 12, 85)), [Gps(GpsFix.FIX_3D, 12, 0.85)]),
        (from_autopilot(gps(0, 255, 65_535)), [Gps(GpsFix.NO_GPS)]),
        (from_autopilot(gps(9, 12, 85)), []),
        (from_autopilot(version(0x010F00FF)), [Airframe(12, 2, 0x010F00FF)]),
        (from_autopilot(version(0)), []),
        (from_autopilot(parameter(b"MPC_XY_VEL_MAX", 12.0)), [MaxGroundspeed(12.0)]),
        (from_autopilot(parameter(b"MPC_XY_CRUISE", 5.0)), []),
    ],
)
def test_a_message_tells_its_states(vehicle: Vehicle, message: Any, told: list[Any]) -> None:
    assert vehicle.update(message, 0) == told


@pytest.mark.parametrize("first", [4, 8, 200])
def test_a_heartbeat_of_an_unknown_or_another_kind_is_nobodys(first: int) -> None:
    vehicle = Vehicle(1)
    assert vehicle.update(heartbeat(kind=first), 0) == []
    assert not vehicle.is_alive(0)
    vehicle.update(heartbeat(), 0)
    assert vehicle.update(heartbeat(armed=True, kind=first), 2000) == []
    assert vehicle.seen(Armed) == Armed(False)
    assert not vehicle.is_alive(3001)


def test_what_kinds_mean_differently_is_not_read_before_the_kind_is_known() -> None:
    vehicle = Vehicle(1)
    for message in (from_autopilot(health(1, 1, 1)), from_autopilot(parameter(b"MPC_XY_CRUISE", 5.0))):
        assert vehicle.update(message, 0) == []
    assert vehicle.cruise_m_s is None


@pytest.mark.parametrize(("system", "component"), [(2, 1), (1, 191)])
def test_others_are_not_listened_to(system: int, component: int) -> None:
    vehicle = Vehicle(1)
    assert vehicle.update(from_autopilot(battery(87), system, component), 0) == []
    assert (vehicle.number, vehicle.states) == (0, {})


def test_an_autopilot_is_alive_for_three_seconds_after_a_heartbeat() -> None:
    vehicle = Vehicle(1)
    assert not vehicle.is_alive(0)
    vehicle.update(heartbeat(), 1000)
    assert vehicle.is_alive(4000)
    assert not vehicle.is_alive(4001)


def test_newer_means_a_later_message() -> None:
    vehicle = Vehicle(1)
    vehicle.update(heartbeat(armed=True), 0)
    number = vehicle.number
    vehicle.update(home(), 0)
    assert vehicle.seen(Armed) == Armed(True)
    assert vehicle.seen(Armed, number) is None
    vehicle.update(heartbeat(armed=True), 0)
    assert vehicle.seen(Armed, number) == Armed(True)


@pytest.mark.parametrize(
    "message",
    [
        mavlink.MAVLink_global_position_int_message(0, 1_044_000_000, -289_000_000, 0, 0, 0, 0, 0, 9000),
        mavlink.MAVLink_global_position_int_message(0, 0, 1_800_000_001, 0, 0, 0, 0, 0, 9000),
        mavlink.MAVLink_home_position_message(0, 0, 2**31 - 1, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0),
        mavlink.MAVLink_vfr_hud_message(0.0, 1e30, 0, 0, 0.0, 0.0),
        mavlink.MAVLink_param_value_message(b"MPC_XY_VEL_MAX", -1.0, 9, 1, 0),
    ],
)
def test_what_cannot_be_is_not_believed(message: Any) -> None:
    vehicle = Vehicle(1)
    for known in (heartbeat(), home(), position()):
        vehicle.update(known, 0)
    before = dict(vehicle.states)
    with pytest.raises(PayloadError, match=r"^\w+\.\w+: expected -?\d+ to \d+, got [-\d]"):
        vehicle.update(from_autopilot(message), 0)
    assert vehicle.states == before


def test_parameters_that_nobody_reads_are_not_kept(vehicle: Vehicle) -> None:
    before = set(vars(vehicle))
    sizes = {name: len(value) for name, value in vars(vehicle).items() if hasattr(value, "__len__")}
    for number in range(1000):
        assert vehicle.update(from_autopilot(parameter(f"P{number}".encode(), 1.0)), 0) == []
    assert set(vars(vehicle)) == before
    assert {name: len(value) for name, value in vars(vehicle).items() if hasattr(value, "__len__")} == sizes
    assert "PARAM_VALUE" in vehicle.arrivals._of_kind
    assert len(vehicle.arrivals._of_kind) < 10


def test_a_lost_fix_is_not_armable_before_the_autopilot_knows_of_it(vehicle: Vehicle) -> None:
    verdict, receiving, blind = (
        from_autopilot(message) for message in (health(0b1, 0b1, PREARM), gps(3, 12, 85), gps(1, 0, 9999))
    )
    vehicle.update(verdict, 0)
    assert Health(False, 1) not in vehicle.update(blind, 0)  # it never had a fix
    vehicle.update(receiving, 1000)
    assert vehicle.update(blind, 2000)[1:] == [Health(False, 1)]
    assert vehicle.update(blind, 11_000)[1:] == []
    assert vehicle.update(verdict, 12_000) == [Health(False, 1)]
    assert vehicle.update(verdict, 12_001) == [Health(True, 1)]  # it knows, and would arm: indoors, by other sensors
    vehicle.update(receiving, 13_000)
    vehicle.update(blind, 14_000)
    assert vehicle.update(verdict, 15_000) == [Health(False, 1)]
    vehicle.update(receiving, 16_000)
    assert vehicle.update(verdict, 16_000) == [Health(True, 1)]


def test_a_fix_that_is_lost_before_any_verdict_says_nothing_of_arming(vehicle: Vehicle) -> None:
    vehicle.update(from_autopilot(gps(3, 12, 85)), 0)
    assert vehicle.update(from_autopilot(gps(1, 0, 9999)), 0) == [Gps(GpsFix.NO_FIX, 0, 99.99)]
    assert vehicle.update(from_autopilot(health(0b1, 0b1, PREARM)), 1000) == [Health(False, 1)]
