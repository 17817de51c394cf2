"""What a witness makes of a real autopilot's messages, and what it writes down."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.errors import SitlError
from sitl.real.watching import Watching
from sitl.real.witness import WANTED_HZ, Witness
from tests.rigs.processes import eventually, free_port

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
ON_GROUND, IN_AIR = mavlink.MAV_LANDED_STATE_ON_GROUND, mavlink.MAV_LANDED_STATE_IN_AIR
S = 1_000_000_000


def packed(message: Any, system: int = 3, component: int = 1) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, system, component)))


def heartbeat(armed: bool, system: int = 3, component: int = 1) -> bytes:
    return packed(mavlink.MAVLink_heartbeat_message(2, 12, ARMED if armed else 1, 0, 4, 3), system, component)


def landed_state(state: int) -> bytes:
    return packed(mavlink.MAVLink_extended_sys_state_message(0, state))


def position(boot_ms: int, up_mm: int = 10_000) -> bytes:
    place = (473_977_420, 85_455_940, 498_000, up_mm)
    return packed(mavlink.MAVLink_global_position_int_message(boot_ms, *place, 0, 0, 0, 0))


def system_time(boot_ms: int) -> bytes:
    return packed(mavlink.MAVLink_system_time_message(0, boot_ms))


def health(bits: int) -> bytes:
    return packed(mavlink.MAVLink_sys_status_message(0, 0, bits, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0))


def test_each_arming_and_disarming_is_told_once() -> None:
    witness = Witness(3)
    said = [witness.take(heartbeat(armed), 0) for armed in (False, True, True, False, False)]
    assert said == [[], [{"event": "armed"}], [], [{"event": "disarmed"}], []]


def test_each_takeoff_and_landing_is_told_once_whatever_is_between() -> None:
    witness = Witness(3)
    states = (mavlink.MAV_LANDED_STATE_UNDEFINED, ON_GROUND, mavlink.MAV_LANDED_STATE_TAKEOFF, IN_AIR)
    said = [witness.take(landed_state(state), 0) for state in (*states, mavlink.MAV_LANDED_STATE_LANDING, ON_GROUND)]
    assert said == [[], [], [{"event": "took_off"}], [], [], [{"event": "landed"}]]


def test_an_autopilot_that_is_first_heard_in_the_air_has_not_taken_off_then() -> None:
    assert Witness(3).take(landed_state(IN_AIR), 0) == []


def test_places_and_times_are_told_once_a_second_and_the_newest_place_is_kept() -> None:
    witness = Witness(3)
    events = [event for i in range(21) for event in witness.take(position(1000 + 100 * i, 10 * i), 5 * S + S // 10 * i)]
    assert [event["boot_ms"] for event in events] == [1000, 2000, 3000]
    assert events[1] == {"event": "position", "boot_ms": 2000, **PLACE, "altitude_m": 0.1}
    assert witness.place == {**PLACE, "altitude_m": 0.2}
    assert witness.take(system_time(4321), 9 * S) == [{"event": "clock", "boot_ms": 4321}]


PLACE = {"latitude_deg": 47.397742, "longitude_deg": 8.545594}


def test_it_is_armable_once_its_checks_before_arming_have_passed() -> None:
    witness = Witness(3)
    witness.take(health(mavlink.MAV_SYS_STATUS_SENSOR_GPS), 0)
    assert not witness.is_armable
    witness.take(health(mavlink.MAV_SYS_STATUS_PREARM_CHECK), 0)
    assert witness.is_armable


def test_what_does_not_come_is_asked_for_until_it_does() -> None:
    witness = Witness(3)
    assert witness.requests(10 * S) == []  # nobody is there to be asked
    witness.take(heartbeat(False), 10 * S)
    parser = mavlink.MAVLink(None)
    asked = [parser.parse_char(request) for request in witness.requests(10 * S)]
    assert {(r.target_system, r.command) for r in asked} == {(3, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)}
    assert {mavlink.mavlink_map[int(r.param1)].msgname: 1e6 / r.param2 for r in asked} == pytest.approx(WANTED_HZ)
    assert witness.requests(11 * S) == []
    for told in (landed_state(ON_GROUND), position(1), health(0)):
        witness.take(told, 12 * S)
    (left,) = [parser.parse_char(request) for request in witness.requests(12 * S)]
    assert left.param1 == mavlink.MAVLINK_MSG_ID_SYSTEM_TIME


def test_other_systems_and_components_are_not_its_autopilot() -> None:
    witness = Witness(3)
    assert witness.take(heartbeat(True, system=4), 0) == []
    assert witness.take(heartbeat(True, component=191), 0) == []
    assert witness.told_ns is None


def test_bytes_that_are_no_mavlink_are_passed_over() -> None:
    witness = Witness(3)
    assert witness.take(b"\xfd\xff garbage", 0) == []
    assert witness.take(heartbeat(True), 0) == [{"event": "armed"}]


@pytest.mark.long
async def test_files_are_as_the_stand_ins_and_requests_go_to_the_autopilot_alone(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    log, place, ready = tmp_path / "uav3.jsonl", tmp_path / "position.json", tmp_path / "ready"
    watching = Watching(3, ("127.0.0.1", port), events=log, ready_file=ready, position_file=place)
    task = asyncio.create_task(watching.run())
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        other.setblocking(False)

        def is_there(file: Path) -> bool:
            autopilot.sendto(heartbeat(True), ("127.0.0.1", port))
            autopilot.sendto(position(1000), ("127.0.0.1", port))
            other.sendto(heartbeat(True, system=4), ("127.0.0.1", port))
            return file.exists()

        await eventually(lambda: is_there(place), "its place")
        assert not ready.exists()
        autopilot.sendto(health(mavlink.MAV_SYS_STATUS_PREARM_CHECK), ("127.0.0.1", port))
        await eventually(lambda: is_there(ready), "it is ready")
        assert autopilot.recv(2048)
        with pytest.raises(BlockingIOError):
            other.recv(2048)
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
    armed, told = [json.loads(line) for line in log.read_text().splitlines()][:2]
    assert (armed["event"], told["event"], told["altitude_m"]) == ("armed", "position", 10.0)
    assert isinstance(armed["t_ns"], int)
    assert json.loads(place.read_text())["latitude_deg"] == pytest.approx(47.397742)


def test_a_port_that_is_taken_is_said() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(SitlError, match=f"127.0.0.1:{port}.*Address already in use"):
            Watching(3, ("127.0.0.1", port))
