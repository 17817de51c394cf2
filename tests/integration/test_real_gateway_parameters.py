"""MAVLink clients read and set the parameters of a real PX4 and ArduCopter through the gateway.

PX4_DIR=FOLDER and ARDUPILOT_DIR=FOLDER name them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from tests.rigs.either_autopilot import flight_of
from tests.rigs.gateway import Client
from tests.rigs.processes import Process, free_port, wait_until
from tests.rigs.real_flights import SYSTEM, Flight

pytestmark = [pytest.mark.integration, pytest.mark.alone, pytest.mark.timeout(400)]
LIST_S = 120.0
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32


@dataclass
class Tried:
    flight: Flight
    client: Client
    is_px4: bool

    def ask(self, message: Any) -> None:
        self.client.link.mav.send(message)

    def value(self, name: str, since: int) -> Any:
        """The first PARAM_VALUE of a name behind message number `since`."""
        return self.client.until(
            lambda one: one.get_type() == "PARAM_VALUE" and one.param_id == name, name, LIST_S, since=since
        )

    def listed(self, since: int) -> dict[int, Any]:
        """By their places."""
        found = [one for one in self.client.messages[since:] if one.get_type() == "PARAM_VALUE"]
        return {one.param_index: one for one in found if one.param_index < one.param_count}


@pytest.fixture(scope="module", params=["px4", "copter"])
def tried(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tried]:
    folder: Path = tmp_path_factory.mktemp("flight")
    flight = flight_of(request.param, folder)
    flight.uav = Process(folder, "uav", "mqttxt", "uav", *flight.uav_options("uav"), "--all-states")
    port = free_port()
    where = ["--cloud", flight.cloud.url, "--listen", f"tcp:127.0.0.1:{port}"]
    gateway = Process(folder, "gateway", "mqttxt", "gs", "mavlink", "--fog", "1", *where)
    with flight:
        gateway.start()
        try:
            wait_until(lambda: f"drone {SYSTEM}: is there" in gateway.log.read_text(), "the gateway shows it", 60)
            client = Client(port)
            client.pump()
            yield Tried(flight, client, request.param == "px4")
            client.close()
        finally:
            gateway.kill()


def test_the_list_is_whole_and_has_the_autopilots_own_hash(tried: Tried, capsys: pytest.CaptureFixture[str]) -> None:
    """With the autopilot's takeoff altitude as the gateway's own, the hash of what is shown is the autopilot's."""
    client, seen, times_s = tried.client, len(tried.client.messages), []
    tried.ask(mavlink.MAVLink_param_set_message(SYSTEM, 1, b"MIS_TAKEOFF_ALT", 2.5, REAL32))
    tried.value("MIS_TAKEOFF_ALT", seen)
    for _ in range(2):
        begun_s, seen = time.monotonic(), len(client.messages)
        tried.ask(mavlink.MAVLink_param_request_list_message(SYSTEM, 1))
        first = client.until(lambda one: one.get_type() == "PARAM_VALUE", "the list begins", LIST_S, since=seen)
        times_s.append(time.monotonic() - begun_s)
        client.until(
            lambda one: one.get_type() == "PARAM_VALUE" and one.param_index == one.param_count - 1,
            "it ends",
            LIST_S,
            since=seen,
        )
        assert {*tried.listed(seen)} == {*range(first.param_count)}
    names = [one.param_id for one in tried.listed(seen).values()]
    assert len(names) == len({*names}) > 800
    if tried.is_px4:
        pilot = tried.flight.pilot
        pilot.ask_for_parameter("_HASH_CHECK")
        wait_until(
            lambda: getattr(pilot.latest.get("PARAM_VALUE"), "param_id", "") == "_HASH_CHECK", "the autopilot's hash"
        )
        assert tried.value("_HASH_CHECK", seen).param_value == pilot.latest["PARAM_VALUE"].param_value
    with capsys.disabled():
        print(f"\n{len(names)} parameters; the first after {times_s[0]:.1f} s, and {times_s[1]:.2f} s the second time")


def test_a_value_is_set_and_a_guarded_one_is_not(tried: Tried) -> None:
    client, name = tried.client, b"MPC_XY_CRUISE" if tried.is_px4 else b"WPNAV_SPEED"
    guarded = b"CBRK_SUPPLY_CHK" if tried.is_px4 else b"FS_THR_ENABLE"
    seen = len(client.messages)
    tried.ask(mavlink.MAVLink_param_request_read_message(SYSTEM, 1, name, -1))
    wanted = tried.value(name.decode(), seen).param_value + 1
    seen = len(client.messages)
    tried.ask(mavlink.MAVLink_param_set_message(SYSTEM, 1, name, wanted, REAL32))
    assert tried.value(name.decode(), seen).param_value == wanted
    tried.ask(mavlink.MAVLink_param_set_message(SYSTEM, 1, guarded, 0.0, REAL32))
    error = client.until(lambda one: one.get_type() == "PARAM_ERROR", "an error", since=seen)
    assert (error.param_id.encode(), error.error) == (guarded, mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED)
