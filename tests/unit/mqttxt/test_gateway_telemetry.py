"""What a MAVLink ground station is shown of a drone: made from its states, unknown where they are (docs/gateway.md)."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import (
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
    KnownState,
    Landed,
    LandedState,
    Location,
    Power,
    State,
    VelocityNed,
)
from mqttxt.gateway.modes import ARDUPILOT, PX4, base_mode, command_for, custom_mode, mode_of_command
from mqttxt.gateway.telemetry import LOCAL, Turns, View

QUAD = Airframe(PX4, mavlink.MAV_TYPE_QUADROTOR, 0x010F00FF)
FLYING = (
    QUAD,
    Armed(True),
    FlightMode(FlightModeName.HOLD),
    LandedState(Landed.IN_AIR),
    Location(47.397742, 8.545594, 498.0, 10.0),
    VelocityNed(1.5, -0.5, -0.25),
    Heading(359.99),
    Groundspeed(1.58),
    Home(47.397, 8.545, 488.0),
    Battery(87),
    Power(15.8, 2.1),
    Gps(GpsFix.RTK_FIXED, 14, 0.7),
    Health(True, 0),
)


def view(*states: State, age_ms: int | None = 300) -> View:
    return View(3, {state.name: KnownState(state, age_ms) for state in states}, 20_000)


def made(name: str, *states: State, **options: Any) -> Any:
    """A message as a client decodes it, None where it is not sent."""
    message = LOCAL[name].make(view(*states, **options))
    if message is None:
        return None
    packet = message.pack(mavlink.MAVLink(None, srcSystem=3, srcComponent=1))
    return mavlink.MAVLink(None).decode(bytearray(packet))


def test_a_drone_in_flight_is_the_vehicle_that_it_is() -> None:
    heartbeat = made("HEARTBEAT", *FLYING)
    assert (heartbeat.type, heartbeat.autopilot, heartbeat.system_status) == (2, 12, mavlink.MAV_STATE_ACTIVE)
    assert heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert mavutil.mode_string_v10(heartbeat) == "LOITER"
    position = made("GLOBAL_POSITION_INT", *FLYING)
    assert (position.lat, position.lon, position.alt, position.relative_alt) == (473977420, 85455940, 498000, 10000)
    assert (position.vx, position.vy, position.vz, position.hdg) == (150, -50, -25, 35999)
    assert position.time_boot_ms == 19_700, "when it was measured"
    hud = made("VFR_HUD", *FLYING)
    assert (hud.groundspeed, hud.climb, hud.heading, hud.alt) == (pytest.approx(1.58), 0.25, 0, 498.0)
    gps = made("GPS_RAW_INT", *FLYING)
    assert (gps.fix_type, gps.satellites_visible, gps.eph, gps.lat) == (6, 14, 70, 473977420)
    battery = made("BATTERY_STATUS", *FLYING)
    assert (battery.voltages[0], battery.current_battery, battery.battery_remaining) == (15_800, 210, 87)
    home = made("HOME_POSITION", *FLYING)
    assert (home.latitude, home.longitude, home.altitude) == (473970000, 85450000, 488000)
    assert made("EXTENDED_SYS_STATE", *FLYING).landed_state == mavlink.MAV_LANDED_STATE_IN_AIR
    version = made("AUTOPILOT_VERSION", *FLYING)
    assert version.flight_sw_version == 0x010F00FF
    assert not version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_FTP


def test_a_gateway_that_runs_for_fifty_days_still_sends_positions() -> None:
    states = {state.name: KnownState(state, 300) for state in FLYING}
    known = View(3, states, 2**32 + 1000)
    packet = LOCAL["GLOBAL_POSITION_INT"].make(known).pack(mavlink.MAVLink(None, srcSystem=3, srcComponent=1))
    assert mavlink.MAVLink(None).decode(bytearray(packet)).time_boot_ms == 700


def test_what_is_not_known_is_mavlinks_unknown_or_not_sent() -> None:
    bare = (QUAD, Armed(False), FlightMode(FlightModeName.HOLD))
    for name in ("GLOBAL_POSITION_INT", "VFR_HUD", "GPS_RAW_INT", "BATTERY_STATUS", "HOME_POSITION"):
        assert made(name, *bare) is None, name
    status = made("SYS_STATUS", *bare)
    assert (status.voltage_battery, status.current_battery, status.battery_remaining) == (65_535, -1, -1)
    assert status.onboard_control_sensors_present == status.onboard_control_sensors_health == 0
    assert made("EXTENDED_SYS_STATE", *bare).landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED
    place = (Location(47.0, 8.0, 498.0, 10.0), VelocityNed(0, 0, 0))
    assert made("GLOBAL_POSITION_INT", *bare, *place).hdg == 65_535
    assert made("GLOBAL_POSITION_INT", *bare, place[0]) is None, "MAVLink has no unknown velocity"
    hud = made("VFR_HUD", *bare, place[0], Heading(1.0), Groundspeed(2.0))
    assert math.isnan(hud.airspeed)
    assert math.isnan(hud.climb)
    battery = made("BATTERY_STATUS", Battery(50))
    assert battery.voltages == [65_535] * 10
    assert (battery.current_battery, battery.current_consumed, battery.temperature) == (-1, -1, 32_767)
    assert made("BATTERY_STATUS", Power(16.0)).battery_remaining == -1
    gps = made("GPS_RAW_INT", Gps(GpsFix.NO_GPS))
    assert (gps.fix_type, gps.satellites_visible, gps.eph, gps.epv, gps.vel) == (0, 255, *[65_535] * 3)
    assert made("GPS_RAW_INT", Gps(GpsFix.FIX_3D, 12)) is None, "a fix without a place is none"
    assert made("AUTOPILOT_VERSION", Airframe(12, 2)).flight_sw_version == 0


@pytest.mark.parametrize("missing", [Airframe, Armed, FlightMode])
def test_without_what_a_heartbeat_says_there_is_none(missing: type[State]) -> None:
    assert made("HEARTBEAT", *(state for state in FLYING if not isinstance(state, missing))) is None


def test_a_failing_sensor_and_a_drone_that_would_not_arm_show() -> None:
    status = made("SYS_STATUS", Health(False, mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG))
    assert status.onboard_control_sensors_present & mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    assert not status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    assert not status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO


@pytest.mark.parametrize("autopilot", [PX4, ARDUPILOT])
def test_every_mode_of_an_autopilot_comes_back_as_itself(autopilot: int) -> None:
    known = [mode for mode in FlightModeName if custom_mode(autopilot, mode) is not None]
    assert len(known) > 10
    for mode in known:
        custom = custom_mode(autopilot, mode) or 0
        main, sub = (custom, 0) if autopilot == ARDUPILOT else (custom >> 16 & 0xFF, custom >> 24)
        assert mode_of_command(autopilot, main, sub) is mode


def test_a_mode_that_is_not_of_the_autopilot_is_none() -> None:
    assert custom_mode(PX4, FlightModeName.GUIDED) is None
    assert not base_mode(PX4, FlightModeName.GUIDED, armed=True) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    assert custom_mode(mavlink.MAV_AUTOPILOT_GENERIC, FlightModeName.HOLD) is None
    assert command_for(mavlink.MAV_AUTOPILOT_GENERIC, FlightModeName.HOLD) is None


def test_messages_come_at_their_rates_and_at_once_when_hastened() -> None:
    turns, counts = Turns(), dict.fromkeys(LOCAL, 0)
    for now_ms in range(0, 10_000, 50):
        for name in turns.due(1, now_ms):
            counts[name] += 1
    assert counts == {name: made.rate_hz * 10 for name, made in LOCAL.items()}
    assert "HEARTBEAT" not in turns.due(1, 10_000 - 50)
    turns.hasten(1, "HEARTBEAT")
    assert "HEARTBEAT" in turns.due(1, 10_000 - 25)


def test_a_rate_that_was_asked_for_is_never_slower_than_the_own_and_bounded() -> None:
    turns = Turns()
    for rate_hz, expected in ((0.1, 4), (1000.0, 10)):
        turns.ask(1, "GLOBAL_POSITION_INT", rate_hz)
        start_ms = int(rate_hz * 100_000)
        times = [now for now in range(start_ms, start_ms + 10_000, 50) if "GLOBAL_POSITION_INT" in turns.due(1, now)]
        assert len(times) == expected * 10
