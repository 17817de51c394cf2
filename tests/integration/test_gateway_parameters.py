"""Parameters through MAVLink at the ground, with clients that people have: MAVSDK, MAVProxy, pymavlink's mavparm."""

from __future__ import annotations

import re
from contextlib import closing
from pathlib import Path

import pytest
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.plugins.param import ParamError
from pymavlink import mavparm
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.security.rights import Rights
from sitl.px4.parameters import SPECS
from tests.integration.test_plans import gs
from tests.rigs.gateway import Client, Flight, Ground, eventually, signing_client, systems
from tests.rigs.mavproxy import MavProxy
from tests.rigs.processes import wait_until
from tests.rigs.secure_system import SecureSystem

pytestmark = [pytest.mark.integration, pytest.mark.apart]


def on_the_drone(ground: Ground, name: str) -> float:
    """What another station reads, which takes control for that."""
    done = gs(ground, "params", "get", name, "--drone", "1", "--take-over")
    assert done.returncode == 0, done.stderr
    return float(done.stdout)


async def test_mavsdk_reads_all_sets_and_is_refused_what_is_guarded(ground: Ground, mavsdk: Mavsdk) -> None:
    system = (await systems(mavsdk))[1]
    flight, param = Flight(system), ParamAsync(system)
    await eventually(flight.telemetry.health, lambda health: health.is_armable)
    found = await param.get_all_params()
    names = {one.name for one in (*found.int_params, *found.float_params)}
    assert names == {*SPECS}
    assert await param.get_param_int("RTL_CONE_ANG") == 45
    await param.set_param_int("RTL_CONE_ANG", 30)
    await param.set_param_float("MPC_XY_CRUISE", 6.5)
    assert await param.get_param_int("RTL_CONE_ANG") == 30
    assert await param.get_param_float("MPC_XY_CRUISE") == 6.5
    with pytest.raises(ParamError, match="PERMISSION_DENIED"):
        await param.set_param_int("NAV_DLL_ACT", 2)
    await flight.said("NAV_DLL_ACT not set: denied(parameter_not_enabled)")
    assert await param.get_param_int("NAV_DLL_ACT") == 0
    assert (on_the_drone(ground, "MPC_XY_CRUISE"), on_the_drone(ground, "NAV_DLL_ACT")) == (6.5, 0)
    flight.close()


def test_mavproxy_fetches_shows_and_sets(ground: Ground, tmp_path: Path) -> None:
    station = MavProxy(tmp_path, f"tcp:127.0.0.1:{ground.tcp}")
    try:
        station.choose(1, of={1, 2})
        station.type("param fetch")
        wait_until(lambda: f"Received {len(SPECS)} parameters" in station.said, "all are there")
        station.type("param show MPC_XY_CRUISE")
        wait_until(lambda: re.search(r"MPC_XY_CRUISE +12\.0", station.said), "one is shown")
        station.type("param set MPC_XY_CRUISE 7")
        wait_until(lambda: on_the_drone(ground, "MPC_XY_CRUISE") == 7, "it is set")
    finally:
        station.close()


def test_a_script_sets_with_mavparm_and_what_is_refused_is_no_success(ground: Ground, client: Client) -> None:
    parameters, link = mavparm.MAVParmDict(), client.link
    client.pump()
    assert parameters.mavset(link, "MPC_XY_CRUISE", 6.0, parm_type=mavlink.MAV_PARAM_TYPE_REAL32)
    client.pump()
    assert not parameters.mavset(link, "CBRK_SUPPLY_CHK", 1.0, parm_type=mavlink.MAV_PARAM_TYPE_REAL32)
    client.pump()
    client.pump()
    seen = len(client.messages)
    link.mav.param_set_send(1, 1, b"NOBODY", 1.0, mavlink.MAV_PARAM_TYPE_REAL32)
    error = client.until(lambda message: message.get_type() == "PARAM_ERROR", "an error", since=seen)
    assert (error.param_id, error.error) == ("NOBODY", mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST)
    client.until(lambda message: "NOBODY not set: " in getattr(message, "text", ""), "why", since=seen)
    assert on_the_drone(ground, "MPC_XY_CRUISE") == 6


def test_what_another_station_sets_is_read_anew(ground: Ground, client: Client) -> None:
    def value() -> float:
        seen = len(client.messages)
        client.link.mav.param_request_read_send(1, 1, b"MPC_XY_CRUISE", -1)
        return float(
            client.until(lambda message: message.get_type() == "PARAM_VALUE", "a value", since=seen).param_value
        )

    assert value() == 12
    done = gs(ground, "params", "set", "MPC_XY_CRUISE", "9", "--drone", "1", "--take-over")
    assert done.returncode == 0, done.stdout + done.stderr
    wait_until(lambda: value() == 9, "the station that has set it has left")


def test_a_station_without_the_right_sets_nothing_in_a_fleet_that_signs(tmp_path: Path) -> None:
    system = SecureSystem(tmp_path, True, "--all-states")
    system.acme.issue("gs-params", Rights(None, take_over=True, observe=True, set_parameters=True))
    system.let_in()
    with closing(system):
        system.start()
        for name, answers in (("gs-ops", "PARAM_ERROR"), ("gs-params", "PARAM_VALUE")):
            with signing_client(system, name) as client:
                client.link.mav.param_set_send(1, 1, b"MPC_XY_CRUISE", 6.0, mavlink.MAV_PARAM_TYPE_REAL32)
                answer = client.until(lambda message: message.get_type().startswith("PARAM_"), "an answer", since=0)
                assert answer.get_type() == answers
