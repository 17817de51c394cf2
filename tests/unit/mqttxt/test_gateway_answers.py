"""What clients ask for when they connect, answered at the ground (docs/gateway.md)."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Airframe, Armed, FlightMode, FlightModeName, Home, KnownState, State
from mqttxt.gateway.answers import Answers
from mqttxt.gateway.clients import Client
from mqttxt.gateway.endpoints import Peer
from mqttxt.gateway.modes import ARDUPILOT, PX4
from mqttxt.gateway.telemetry import Turns, View
from mqttxt.gateway.translation import Request

ACCEPTED, UNSUPPORTED, NOT_NOW = 0, 3, 1
QGC = Client(Peer("qgc", lambda packet: None), 255, 190)


def view(*states: State, number: int = 1, now_ms: int = 0) -> View:
    known = (Airframe(PX4, 2, 1), Armed(False), FlightMode(FlightModeName.HOLD), *states)
    return View(number, {state.name: KnownState(state, 0) for state in known}, now_ms)


def ask(answers: Answers, message: Any, known: View | None = None) -> tuple[list[Any], str | None]:
    parsed = mavlink.MAVLink(None).decode(bytearray(message.pack(mavlink.MAVLink(None, 255, 190))))
    return answers.on_message(parsed, QGC, known or view())


def command(answers: Answers, mav_cmd: int, *params: float, known: View | None = None) -> tuple[int, Any] | None:
    padded = (*params, *[0.0] * (7 - len(params)))
    return answers.on_command(Request(mav_cmd, padded), known or view())


@pytest.mark.parametrize(
    ("number", "known", "result", "kind"),
    [
        (mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, view(), ACCEPTED, "AUTOPILOT_VERSION"),
        (mavlink.MAVLINK_MSG_ID_HOME_POSITION, view(Home(47, 8, 488)), ACCEPTED, "HOME_POSITION"),
        (mavlink.MAVLINK_MSG_ID_HOME_POSITION, view(), NOT_NOW, None),
        (mavlink.MAVLINK_MSG_ID_ATTITUDE, view(), UNSUPPORTED, None),
        (397, view(), UNSUPPORTED, None),
        (435, view(), UNSUPPORTED, None),
        (float("inf"), view(), UNSUPPORTED, None),
    ],
)
def test_a_message_is_sent_or_refused_at_once(number: float, known: View, result: int, kind: str | None) -> None:
    answer = command(Answers(Turns()), mavlink.MAV_CMD_REQUEST_MESSAGE, number, known=known)
    assert answer is not None
    assert answer[0] == result
    assert (None if answer[1] is None else answer[1].get_type()) == kind


def test_the_old_requests_have_answers_too() -> None:
    answers = Answers(Turns())
    version = command(answers, mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1)
    assert version is not None
    assert (version[0], version[1].get_type()) == (ACCEPTED, "AUTOPILOT_VERSION")
    assert version[1].capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    copter = View(1, {"airframe": KnownState(Airframe(ARDUPILOT, 2, 1), 0)}, 0)
    version = command(answers, mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1, known=copter)
    assert version is not None
    assert version[1].capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    assert command(answers, mavlink.MAV_CMD_GET_HOME_POSITION) == (NOT_NOW, None)
    assert command(answers, mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION, 1) == (UNSUPPORTED, None)


def test_rates_of_what_is_made_here_are_taken_and_others_are_for_the_drone() -> None:
    turns = Turns()
    answers = Answers(turns)
    asked = (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 200_000)
    assert command(answers, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, *asked) == (ACCEPTED, None)
    assert sum("EXTENDED_SYS_STATE" in turns.due(1, now_ms) for now_ms in range(0, 10_000, 50)) == 50
    asked = (mavlink.MAVLINK_MSG_ID_ATTITUDE, 200_000)
    assert command(answers, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, *asked) is None
    assert command(answers, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) is None


def test_a_file_is_not_there_and_says_so_at_once() -> None:
    head = struct.pack("<HBBBBBBI", 7, 2, 4, 5, 0, 0, 0, 0) + b"@PARAM/param.pck"
    message = mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, list(head.ljust(251, b"\0")))
    ((refusal,), _) = ask(Answers(Turns()), message)
    payload = bytes(refusal.payload)
    number, session, opcode, size, asked = struct.unpack_from("<HBBBB", payload)
    assert (number, session, opcode, size, asked, payload[12]) == (8, 2, 129, 1, 4, 10)
    assert (refusal.target_system, refusal.target_component) == (255, 190)


@pytest.mark.parametrize(
    "message",
    [
        mavlink.MAVLink_manual_control_message(1, 500, 0, 500, 0, 0),
        mavlink.MAVLink_rc_channels_override_message(1, 1, *[1500] * 8),
        mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0, *[0.0] * 11),
        mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0, [1, 0, 0, 0], 0, 0, 0, 0.5),
    ],
)
def test_steering_is_refused_with_a_text_that_is_not_repeated_for_ten_seconds(message: Any) -> None:
    answers = Answers(Turns())
    told = [ask(answers, message, view(now_ms=now_ms))[1] for now_ms in range(0, 20_001, 100)]
    assert len([text for text in told if text is not None]) == 3
    assert "late" in (told[0] or "")
    assert ask(answers, message, view(number=2, now_ms=20_001))[1] is not None


def test_what_nobody_asked_for_has_no_answer() -> None:
    assert ask(Answers(Turns()), mavlink.MAVLink_system_time_message(0, 0)) == ([], None)
