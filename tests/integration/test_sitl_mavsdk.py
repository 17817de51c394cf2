"""A real MAVSDK flies the stand-in, a process on loopback, as it would fly PX4."""

from __future__ import annotations

import asyncio
import json
import math
import re
import socket
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync, ActionError
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.offboard import VelocityNedYaw
from mavsdk.plugins.telemetry import FlightMode, LandedState

from tests.rigs.gateway import eventually
from tests.rigs.processes import Process, ask_autopilot, free_port

pytestmark = [pytest.mark.integration, pytest.mark.apart]
HOME = (47.397742, 8.545594, 488.0)


class Flight:
    """A stand-in, and MAVSDK connected to it."""

    def __init__(self, system: Any, port: int, folder: Path) -> None:
        self.port = port
        self.folder = folder
        self.action = ActionAsync(system)
        self.telemetry = TelemetryAsync(system)
        self.param = ParamAsync(system)
        self.offboard = OffboardAsync(system)

    def control(self, request: dict[str, Any]) -> dict[str, Any]:
        """The side channel."""
        return ask_autopilot(self.folder / "control.sock", request)

    def events(self) -> list[str]:
        lines = (self.folder / "events.jsonl").read_text().splitlines()
        return [json.loads(line)["event"] for line in lines]

    async def takeoff(self) -> None:
        await self.action.arm()
        await self.action.takeoff()
        await eventually(self.telemetry.flight_mode, lambda mode: mode == FlightMode.HOLD and self.up_m() > 1.5)

    def up_m(self) -> float:
        return float(self.control({"get": "state"})["altitude_m"])


@pytest.fixture
async def flight(tmp_path: Path) -> AsyncIterator[Flight]:
    asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(16))
    port = free_port(socket.SOCK_DGRAM)
    files = ["--events", str(tmp_path / "events.jsonl"), "--control", str(tmp_path / "control.sock")]
    files += ["--ready-file", str(tmp_path / "sitl.ready")]
    own_port = free_port(socket.SOCK_DGRAM)
    ports = ["--listen", f"127.0.0.1:{own_port}", "--send", f"127.0.0.1:{port}", "--quiet"]
    process = Process(tmp_path, "sitl", "sitl", "fly", *ports, *files).start().wait_ready()
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await mavsdk.first_autopilot(timeout_s=60)
        assert system is not None
        yield Flight(system, own_port, tmp_path)
    finally:
        mavsdk.destroy()
        process.kill()


async def test_telemetry_is_there_before_the_flight(flight: Flight) -> None:
    health = await eventually(flight.telemetry.health, lambda found: found.is_armable and found.is_home_position_ok)
    assert health.is_gyrometer_calibration_ok
    assert health.is_accelerometer_calibration_ok
    assert health.is_magnetometer_calibration_ok
    assert health.is_global_position_ok
    position = await eventually(flight.telemetry.position, lambda found: not math.isnan(found.latitude_deg))
    assert (position.latitude_deg, position.longitude_deg) == pytest.approx(HOME[:2], abs=1e-6)
    home = await eventually(flight.telemetry.home, lambda found: not math.isnan(found.absolute_altitude_m))
    assert home.absolute_altitude_m == pytest.approx(HOME[2], abs=0.01)
    battery = await eventually(flight.telemetry.battery, lambda found: found.voltage_v > 0)
    assert battery.remaining_percent == pytest.approx(100)
    assert await flight.telemetry.landed_state() == LandedState.ON_GROUND
    assert not await flight.telemetry.armed()


async def test_a_flight_from_arm_to_disarm(flight: Flight) -> None:
    await flight.param.set_param_float("RTL_RETURN_ALT", 4.0)
    await flight.action.set_takeoff_altitude(4.0)
    await flight.takeoff()
    await eventually(flight.telemetry.landed_state, lambda state: state == LandedState.IN_AIR)
    await flight.action.goto_location(HOME[0] + 15 / 111_195, HOME[1], HOME[2] + 5, math.nan)
    await eventually(flight.telemetry.position, lambda found: found.latitude_deg > HOME[0] + 14 / 111_195)
    await flight.action.hold()
    await flight.action.return_to_launch()
    await eventually(flight.telemetry.flight_mode, lambda mode: mode == FlightMode.RETURN_TO_LAUNCH)
    await eventually(flight.telemetry.armed, lambda armed: not armed)
    position = await flight.telemetry.position()
    assert position.latitude_deg == pytest.approx(HOME[0], abs=1e-5)
    assert [event for event in flight.events() if event in ("armed", "took_off", "landed", "disarmed")] == [
        *("armed", "took_off", "landed", "disarmed")
    ]


async def test_land_disarms_by_itself(flight: Flight) -> None:
    await flight.takeoff()
    await flight.action.land()
    await eventually(flight.telemetry.flight_mode, lambda mode: mode == FlightMode.LAND)
    await eventually(flight.telemetry.armed, lambda armed: not armed)


async def test_arm_and_disarm_on_the_ground(flight: Flight) -> None:
    await flight.action.arm()
    await eventually(flight.telemetry.armed, bool)
    await flight.action.disarm()
    await eventually(flight.telemetry.armed, lambda armed: not armed)


async def test_denials_are_errors(flight: Flight) -> None:
    flight.control({"set": {"healthy": False}})
    with pytest.raises(ActionError):
        await flight.action.arm()
    flight.control({"set": {"healthy": True, "altitude_m": 10}})
    with pytest.raises(ActionError):
        await flight.action.disarm()


async def test_a_takeoff_while_disarmed_is_accepted_and_waits_for_the_arming(flight: Flight) -> None:
    await flight.action.takeoff()
    await eventually(flight.telemetry.flight_mode, lambda mode: mode == FlightMode.TAKEOFF)
    assert flight.up_m() == 0
    await flight.action.arm()
    await eventually(flight.telemetry.flight_mode, lambda mode: mode == FlightMode.HOLD and flight.up_m() > 1.5)


async def test_a_lost_acknowledgement_is_a_timeout_though_it_was_done(flight: Flight) -> None:
    flight.control({"set": {"mute": ["COMMAND_ACK"]}})
    with pytest.raises(ActionError):
        await flight.action.arm()
    assert flight.control({"get": "state"})["armed"]


async def test_parameters(flight: Flight) -> None:
    assert await flight.param.get_param_float("MPC_XY_CRUISE") == 5.0
    await flight.param.set_param_float("MPC_XY_CRUISE", 7.5)
    assert await flight.param.get_param_float("MPC_XY_CRUISE") == 7.5
    await flight.param.set_param_int("NAV_DLL_ACT", 2)
    assert await flight.param.get_param_int("NAV_DLL_ACT") == 2


async def test_offboard_velocity(flight: Flight) -> None:
    await flight.takeoff()
    await flight.offboard.set_velocity_ned(VelocityNedYaw(2.0, 0.0, 0.0, 0.0))
    await flight.offboard.start()
    await eventually(flight.telemetry.flight_mode, lambda mode: mode == FlightMode.OFFBOARD)
    await eventually(flight.telemetry.velocity_ned, lambda found: found.north_m_s > 1.6)
    await flight.offboard.stop()
    await eventually(flight.telemetry.flight_mode, lambda mode: mode == FlightMode.HOLD)


async def test_a_pilot_changes_the_mode(flight: Flight) -> None:
    flight.control({"set": {"mode": "position"}})
    await eventually(flight.telemetry.flight_mode, lambda mode: mode == FlightMode.POSCTL)


async def test_noise_on_the_link_does_not_end_it(flight: Flight) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for data in (b"", b"\xfd", b"\xfd\xff\x00", b"hello", bytes(range(256)), b"\xfe\x09" * 40, b"\xfd" * 280):
            sock.sendto(data, ("127.0.0.1", flight.port))
    await flight.action.arm()
    assert flight.control({"get": "state"})["armed"]
    log = (flight.folder / "sitl.log").read_text()
    assert "Traceback" not in log
    assert "cut short" in log


async def test_the_printed_way_to_connect_works(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    ports = ["--listen", "127.0.0.1:0", "--send", f"127.0.0.1:{port}"]
    sitl = Process(tmp_path, "sitl", "sitl", "fly", "--system", "201", "--gcs", *ports).start()
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        await eventually(lambda: asyncio.to_thread(sitl.log.read_text), lambda text: "MQTT-XT" in text)
        printed = re.search(r'add_any_connection\("(.*)"\)', sitl.log.read_text())
        assert printed is not None
        await mavsdk.add_any_connection(printed[1])
        assert await mavsdk.first_autopilot(timeout_s=60) is not None
    finally:
        mavsdk.destroy()
        sitl.kill()


def test_ended_by_a_signal_it_leaves_quietly(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    options = ["--listen", "127.0.0.1:0", "--send", f"127.0.0.1:{port}", "--ready-file", str(tmp_path / "sitl.ready")]
    sitl = Process(tmp_path, "sitl", "sitl", "fly", *options).start().wait_ready()
    assert sitl.stop() == 0
    assert sitl.log.read_text() == ""
