"""What a vehicle answers beside flying: requests, pings, files, and the side channel."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.errors import SitlError

NAN = float("nan")


@pytest.mark.parametrize(("wanted", "kind"), [(148, "AUTOPILOT_VERSION"), (242, "HOME_POSITION"), (245, None)])
def test_messages_on_request(drone: Any, wanted: int, kind: str | None) -> None:
    ack, answer = drone.tell(mavlink.MAVLink_command_long_message(1, 1, 512, 0, wanted, 0, 0, 0, 0, 0, 0))
    assert (ack.command, ack.result, ack.target_system, ack.target_component) == (512, 0, 245, 190)
    assert answer.get_type() == (kind or "EXTENDED_SYS_STATE")


def test_the_old_way_to_ask_for_the_version(drone: Any) -> None:
    ack, answer = drone.tell(mavlink.MAVLink_command_long_message(1, 1, 520, 0, 1, 0, 0, 0, 0, 0, 0))
    assert ack.result == 0
    plans = mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    assert answer.capabilities & plans == plans, "MAVSDK uploads no mission without MISSION_INT"


def test_requests_for_nothing_are_not_accepted(drone: Any) -> None:
    assert drone.command(512, 9999) == mavlink.MAV_RESULT_DENIED
    assert drone.command(512, NAN) == mavlink.MAV_RESULT_DENIED


def test_a_ping_is_answered_to_its_sender_and_answers_are_not(drone: Any) -> None:
    (answer,) = drone.tell(mavlink.MAVLink_ping_message(123, 7, 0, 0))
    assert (answer.time_usec, answer.seq, answer.target_system, answer.target_component) == (123, 7, 245, 190)
    assert drone.tell(mavlink.MAVLink_ping_message(123, 7, 1, 1)) == []


def test_timesync_is_answered_and_answers_are_not(drone: Any) -> None:
    drone.fly(2)
    (answer,) = drone.tell(mavlink.MAVLink_timesync_message(0, 99))
    assert (answer.tc1, answer.ts1) == (pytest.approx(2e9), 99)
    assert drone.tell(mavlink.MAVLink_timesync_message(1, 99)) == []


def test_mavproxys_file_request_gets_a_nak(drone: Any) -> None:
    request = bytes([5, 0, 3, 4, *[0] * 8]).ljust(251, b"\0")
    (answer,) = drone.tell(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, list(request)))
    payload = bytes(answer.payload)
    assert int.from_bytes(payload[:2], "little") == 6
    assert (payload[2], payload[3], payload[4], payload[5], payload[12]) == (3, 129, 1, 4, 10)


def test_a_ground_stations_heartbeat_has_no_answer(drone: Any) -> None:
    assert drone.tell(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)) == []


def test_the_side_channel_tells_the_state(drone: Any) -> None:
    drone.take_off()
    state, outputs = drone.vehicle.control({"get": "state"})
    assert outputs == []
    assert (state["mode"], state["armed"], state["landed"], state["healthy"]) == ("hold", True, False, True)
    assert state["altitude_m"] == pytest.approx(10, abs=0.3)


def test_the_side_channel_puts_the_drone_into_a_state(drone: Any) -> None:
    wanted = {"mode": "position", "altitude_m": 20, "battery_pct": 50, "healthy": False}
    state, outputs = drone.vehicle.control({"set": wanted})
    assert {name: state[name] for name in wanted} == wanted
    assert state["armed"], "it could not hover otherwise"
    assert [o.detail["mode"] for o in outputs if hasattr(o, "detail") and o.event == "mode"] == ["position"]
    assert drone.heartbeat.custom_mode >> 16 == 3


def test_a_muted_message_is_not_sent_until_the_mute_ends(drone: Any) -> None:
    drone.vehicle.control({"set": {"mute": ["COMMAND_ACK", "HEARTBEAT"]}})
    assert drone.command(400, 1) is None
    assert drone.autopilot.armed, "carried out all the same"
    assert drone.sent("HEARTBEAT") == []
    assert "HEARTBEAT" not in [m.get_type() for t in range(300) for m in drone.vehicle.streamed(0, t / 100)]
    drone.vehicle.control({"set": {"mute": []}})
    assert drone.command(400, 0) == 0


@pytest.mark.parametrize(
    ("request_", "error"),
    [
        ([], 'expected {"get": "state"}'),
        ({"get": "all"}, 'expected {"get": "state"}'),
        ({"set": {"colour": 1}}, "set colour: expected one of mode, armed"),
        ({"set": {"mode": "fast"}}, "set mode: expected one of manual, .*got 'fast'"),
        ({"set": {"armed": "no"}}, "set armed: expected true or false, got 'no'"),
        ({"set": {"battery_pct": NAN}}, "set battery_pct: expected a number from 0 to 100"),
        ({"set": {"altitude_m": -1}}, "set altitude_m: expected metres"),
        ({"set": {"mute": ["ACK"]}}, "set mute: expected a list of MAVLink messages"),
    ],
)
def test_the_side_channel_refuses_the_rest_and_changes_nothing(drone: Any, request_: Any, error: str) -> None:
    before = drone.vehicle.control({"get": "state"})
    with pytest.raises(SitlError, match=error):
        drone.vehicle.control(request_)
    assert drone.vehicle.control({"get": "state"}) == before


def test_a_command_can_be_made_to_take_its_time(drone: Any) -> None:
    drone.vehicle.control({"set": {"in_progress": {"command": 400, "percents": [10, 60, 255], "interval_s": 0.5}}})
    assert drone.command(400, 1) == 5
    assert drone.command(400, 1) == 5
    assert not drone.autopilot.armed
    drone.fly(2)
    acks = [(ack.result, ack.progress) for ack in drone.sent("COMMAND_ACK")]
    assert acks == [(5, 10), (5, 10), (5, 60), (5, 255), (0, 0)]
    assert drone.autopilot.armed
    drone.vehicle.control({"set": {"in_progress": {"command": 400, "percents": []}}})
    assert drone.command(400, 0) == 0


@pytest.mark.parametrize(
    "wanted",
    [{}, {"command": 400}, {"command": "400", "percents": []}, {"command": 400, "percents": [256]}, [400]],
)
def test_steps_that_cannot_be_are_refused(drone: Any, wanted: Any) -> None:
    with pytest.raises(SitlError, match="set in_progress: expected"):
        drone.vehicle.control({"set": {"in_progress": wanted}})
