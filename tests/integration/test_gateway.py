"""MAVLink at the ground, with the clients that people have: MAVSDK, MAVProxy and pymavlink (docs/gateway.md)."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path

import pytest
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionError
from mavsdk.plugins.telemetry import FixType, FlightMode, LandedState
from pymavlink import mavparm, mavwp
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.gateway.process import SILENT_MS
from sitl.px4.parameters import SPECS
from tests.rigs.gateway import Client, Flight, Ground, eventually, is_ack, systems
from tests.rigs.mavproxy import MavProxy
from tests.rigs.processes import Process, wait_until

pytestmark = [pytest.mark.integration, pytest.mark.apart]
GATEWAY = pytest.mark.soak("services/mqttxt/src/mqttxt/gateway", "services/mqttxt/src/mqttxt/station")
"""One flight of MAVSDK and one of MAVProxy stand for all, unless gateway or station has changed."""
M_PER_DEGREE = 111_195
NAN = math.nan


async def test_mavsdk_sees_the_drones_as_they_are_and_flies_one(ground: Ground, mavsdk: Mavsdk) -> None:
    found = await systems(mavsdk)
    flight, other = Flight(found[1]), Flight(found[2])
    telemetry, action = flight.telemetry, flight.action
    health = await eventually(telemetry.health, lambda health: health.is_armable and health.is_home_position_ok)
    assert health.is_global_position_ok
    home = await eventually(telemetry.home, lambda home: not math.isnan(home.absolute_altitude_m))
    gps = await eventually(telemetry.gps_info, lambda gps: gps.fix_type == FixType.FIX_3D)
    assert gps.num_satellites > 4
    battery = await eventually(telemetry.battery, lambda battery: battery.voltage_v > 0)
    assert battery.remaining_percent > 50
    await action.set_takeoff_altitude(6.0)
    assert await action.get_takeoff_altitude() == 6.0
    await action.arm()
    await action.takeoff()
    await flight.said("takeoff completed")
    await eventually(telemetry.position, lambda found: abs(found.relative_altitude_m - 6.0) < 1.0)
    await eventually(telemetry.landed_state, lambda state: state == LandedState.IN_AIR)
    start = await telemetry.position()
    north = start.latitude_deg + 15 / M_PER_DEGREE
    await action.goto_location(north, start.longitude_deg, home.absolute_altitude_m + 8.0, NAN)
    await flight.said("goto completed")
    await eventually(telemetry.position, lambda found: abs(found.latitude_deg - north) < 1e-5)
    await eventually(telemetry.position, lambda found: abs(found.relative_altitude_m - 8.0) < 1.0)
    await action.hold()
    await flight.said("hold completed")
    await action.land()
    await eventually(telemetry.flight_mode, lambda mode: mode == FlightMode.LAND)
    await flight.said("land completed")
    assert not await eventually(telemetry.armed, lambda armed: not armed)
    assert not await other.telemetry.armed()
    assert [ground.commanded(2, number) for number in (400, 22, 192, 21)] == [[], [], [], []]
    flight.close()
    other.close()


@GATEWAY
async def test_mavsdk_gets_what_only_the_drone_has_and_a_definite_no(ground: Ground, mavsdk: Mavsdk) -> None:
    flight = Flight((await systems(mavsdk))[1])
    await eventually(flight.telemetry.health, lambda health: health.is_armable)
    await flight.telemetry.set_rate_attitude_euler(5.0)
    await eventually(flight.telemetry.attitude_euler, lambda attitude: not math.isnan(attitude.roll_deg))
    ground.control(1, {"set": {"healthy": False}})
    with pytest.raises(ActionError, match="COMMAND_DENIED"):
        await flight.action.arm()
    ground.activator.stall()
    with pytest.raises(ActionError):
        await flight.action.land()
    ground.activator.go_on()
    await flight.said("land expired")
    assert ground.commanded(1, 21) == [], "what could not be sent in time is not done later"
    flight.close()


def test_mavproxy_connects_and_flies(ground: Ground, tmp_path: Path) -> None:
    station = MavProxy(tmp_path, f"tcp:127.0.0.1:{ground.tcp}")
    try:
        station.choose(1, of={1, 2})
        wait_until(lambda: f"Received {len(SPECS)} parameters" in station.said, "parameters")
        station.type("wp list")
        wait_until(lambda: "Requesting 0 waypoints" in station.said, "no waypoints")
        station.type("arm throttle")
        wait_until(lambda: "AP: arm completed" in station.said, "armed")
        station.type("mode LAND")
        wait_until(lambda: "required argument is not a float" in station.said, "pymavlink's mode fails for a PX4")
        station.type("takeoff 10")
        expected = re.compile(r"expected (\d+\.\d) to fly 10 m")
        wait_until(lambda: expected.search(station.said) is not None, "10 m above sea level is refused")
        found = expected.search(station.said)
        assert found is not None
        station.type(f"takeoff {found[1]}")
        wait_until(lambda: "AP: takeoff completed" in station.said, "up", 60)
        station.type("guided 47.3978 8.5456 12")
        wait_until(lambda: "DO_REPOSITION: ACCEPTED" in station.said, "guided")
        station.type("long DO_SET_MODE 1 3 0")
        wait_until(lambda: "mode POSITION: no command leads to it" in station.said.replace("\nAP: ", ""), "refused")
        station.type("long NAV_LAND")
        wait_until(lambda: "AP: land completed" in station.said, "down", 60)
        assert "fence breach" not in station.said
        assert "armed" not in [event["event"] for event in ground.commanded(2, 400)]
    finally:
        station.close()


def test_what_a_ground_station_asks_when_it_connects_is_answered_at_once(client: Client) -> None:
    mav = client.link.mav
    assert client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == 0
    assert [m.flight_sw_version != 0 for m in client.messages if m.get_type() == "AUTOPILOT_VERSION"] == [True]
    for unknown in (397, 435, 395, 300):
        assert client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, unknown) == mavlink.MAV_RESULT_UNSUPPORTED
    parameters = mavparm.MAVParmDict()
    mav.param_request_list_send(1, 1)
    client.until(lambda message: message.get_type() == "PARAM_VALUE", "parameters")
    assert parameters.mavset(client.link, "MIS_TAKEOFF_ALT", 7.0, retries=3)
    plan = mavwp.MAVWPLoader(1, 1)
    mav.mission_request_list_send(1, 1, 0)
    count = client.until(lambda message: message.get_type() == "MISSION_COUNT", "an empty plan")
    assert (count.count, plan.count()) == (0, 0)
    mav.manual_control_send(1, 0, 0, 500, 0, 0)
    client.text("sticks do not pass")


@GATEWAY
def test_a_takeoff_before_arming_flies_once_the_client_arms(ground: Ground, client: Client) -> None:
    home = client.until(lambda message: message.get_type() == "HOME_POSITION", "home")
    assert client.command(22, -1, 0, 0, NAN, NAN, NAN, home.altitude / 1000 + 5) == 0
    assert ground.commanded(1, 22) == []
    assert client.command(400, 1, 0) == 0
    client.text("takeoff completed", 60)
    here = client.until(lambda message: message.get_type() == "GLOBAL_POSITION_INT", "position")
    assert here.relative_alt == pytest.approx(5000, abs=1000)
    far = round(here.lat + 200 / M_PER_DEGREE * 1e7)
    client.link.mav.command_int_send(1, 1, 5, 192, 0, 0, -1, 1, 0, NAN, far, here.lon, here.alt / 1000)
    client.until(lambda message: is_ack(message, 192, 1) and message.result == 0, "the goto is accepted")
    client.until(lambda message: message.get_type() == "VFR_HUD" and message.groundspeed > 3, "it flies")
    assert client.command(192, -1, 1, 0, NAN, NAN, NAN, NAN) == 0, "QGroundControl's pause in a goto"
    client.text("hold completed")
    client.until(lambda message: message.get_type() == "VFR_HUD" and message.groundspeed < 1, "it stands")
    client.link.mav.set_mode_send(1, 129, 4 << 16 | 6 << 24)
    client.text("land completed", 60)


@GATEWAY
def test_heartbeats_stop_when_the_drone_is_silent_and_come_back(ground: Ground, client: Client) -> None:
    ground.uavs[1].stall()
    stalled_s = time.monotonic()
    wait_until(lambda: client.pump() or "drone 1: is silent" in ground.gateway.log.read_text(), "the heartbeat stops")
    assert time.monotonic() - stalled_s <= SILENT_MS / 1000 + 2
    client.pump()
    before = len(client.messages)
    for _ in range(3):
        client.until(lambda message: message.get_srcSystem() == 2 and message.get_type() == "HEARTBEAT", "drone 2")
    assert {message.get_srcSystem() for message in client.messages[before:]} == {2}
    ground.uavs[1].go_on()
    client.until(lambda message: message.get_srcSystem() == 1 and message.get_type() == "HEARTBEAT", "drone 1 is back")


def test_bad_options_are_one_line(tmp_path: Path) -> None:
    for options, expected in (
        ([], "expected --to udp:HOST:PORT or --listen tcp:HOST:PORT"),
        (["--to", "14550"], "--to '14550': expected udp:HOST:PORT"),
        (["--listen", "tcp:0.0.0.0:5760"], "--insecure-mavlink"),
        (["--to", "udp:127.0.0.1:14550", "--ttl", "61"], "--ttl 61: expected more than 0 and at most 60 s"),
    ):
        process = Process(tmp_path, "bad", "mqttxt", "gs", "mavlink", "--fog", "1", *options).start()
        assert process.wait() == 2
        said = process.log.read_text()
        process.log.unlink()
        assert expected in said
        assert len(said.splitlines()) == 1
