"""MAVLink commands as those of MQTT-XT, or a definite no with a text (docs/gateway.md)."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import (
    Airframe,
    Arm,
    Command,
    Disarm,
    Goto,
    Hold,
    Home,
    KnownState,
    Land,
    Location,
    Mission,
    Resume,
    Return,
    SetCurrentItem,
    StartMission,
    State,
    Stream,
    Takeoff,
    VelocityNed,
)
from mqttxt import Mavlink as Raw
from mqttxt.errors import PayloadError
from mqttxt.gateway.answers import Answers
from mqttxt.gateway.modes import ARDUPILOT, PX4
from mqttxt.gateway.telemetry import Turns, View
from mqttxt.gateway.translation import NOT_NOW, UNSUPPORTED, Declined, Request, command_of
from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import CommandMessage

NAN = float("nan")
INT_MAX = 2**31 - 1
HOME = Home(47.397, 8.545, 488.0)
HERE = Location(47.398, 8.546, 498.0, 10.0)
RELATIVE, ABSOLUTE, LOCAL = 6, 5, 1


def view(*states: State, autopilot: int = PX4) -> View:
    known = (Airframe(autopilot, 2), *states)
    return View(1, {state.name: KnownState(state, 100) for state in known}, 0)


def long(command: int, *params: float) -> Any:
    return mavlink.MAVLink_command_long_message(1, 1, command, 0, *params, *[NAN] * (7 - len(params)))


def int_(command: int, frame: int, x: int, y: int, z: float) -> Any:
    return mavlink.MAVLink_command_int_message(1, 1, frame, command, 0, 0, -1, 1, 0, NAN, x, y, z)


def told(message: Any, known: View | None = None) -> Command:
    return command_of(Request.of(message), known or view(HOME, HERE), 10.0)


PLACE = (473_980_000, 85_460_000)
NAMED = b"named by a client"[:16]
OTHER = b"of another place"
ENTER, ENTER_ARDUPILOT = long(176, 1, 4, 4), long(176, 1, 3)


@pytest.mark.parametrize(
    ("message", "command"),
    [
        (long(400, 1, 0), Arm()),
        (long(400, 0), Disarm()),
        (long(22), Takeoff(10.0)),
        (long(22, -1, 0, 0, NAN, NAN, NAN, 500.0), Takeoff(12.0)),
        (long(22, 0, 0, 0, 0, 0, 0, 498.0), Takeoff(10.0)),  # MAVProxy's `takeoff 498`
        (int_(22, RELATIVE, 0, 0, 7.0), Takeoff(7.0)),
        (long(21), Land()),
        (long(21, 0, 0, 0, 0, 0, 0, 0), Land()),
        (long(20), Return()),
        (long(17), Hold()),
        (int_(192, ABSOLUTE, *PLACE, 498.0), Goto(47.398, 8.546, 10.0)),
        (int_(192, RELATIVE, *PLACE, 25.0), Goto(47.398, 8.546, 25.0)),
        (int_(192, 0, *PLACE, NAN), Goto(47.398, 8.546, 10.0)),
        (int_(192, ABSOLUTE, INT_MAX, INT_MAX, NAN), Hold()),
        (long(192, -1, 1, 0, NAN, NAN, NAN, NAN), Hold()),
        (long(193, 0), Hold()),
        (long(176, 1, 4, 3), Hold()),
        (long(176, 1, 4, 5), Return()),
        (long(176, 1, 4, 6), Land()),
        (mavlink.MAVLink_set_mode_message(1, 129, 4 << 16 | 5 << 24), Return()),
        (long(511, mavlink.MAVLINK_MSG_ID_ATTITUDE, 250_000), Stream("mavlink/ATTITUDE", 4.0)),
        (long(511, mavlink.MAVLINK_MSG_ID_ATTITUDE, -1), Stream("mavlink/ATTITUDE", 0.0)),
        (long(511, mavlink.MAVLINK_MSG_ID_ATTITUDE, 0), Stream("mavlink/ATTITUDE", 0.0)),
        (long(178, 1, 3, -1), Raw(178, (1, 3, -1, None, None, None, None))),
    ],
)
def test_a_command_is_what_it_means(message: Any, command: Command) -> None:
    assert told(message) == command


@pytest.mark.parametrize(
    ("message", "command"),
    [
        (long(22, 0, 0, 0, 0, 0, 0, 7.0), Takeoff(7.0)),
        (long(176, 1, 4), Hold()),
        (long(176, 1, 17), Hold()),
        (long(176, 1, 6), Return()),
        (long(176, 1, 9), Land()),
        (mavlink.MAVLink_set_mode_message(1, 1, 9), Land()),
        (mavlink.MAVLink_set_mode_message(1, 129, 4), Hold()),
    ],
)
def test_ardupilots_modes_and_takeoff_mean_what_ardupilot_means(message: Any, command: Command) -> None:
    assert told(message, view(HOME, HERE, autopilot=ARDUPILOT)) == command


@pytest.mark.parametrize("main", [3, 4, 6, 9])
def test_a_mode_of_a_px4_is_none_of_an_ardupilot(main: int) -> None:
    """PX4's POSITION is 3 << 16, and AUTO, which flies the mission, is ArduPilot's 3."""
    known = replace(view(HOME, HERE, autopilot=ARDUPILOT), named=NAMED)
    with pytest.raises(Declined, match="mode UNKNOWN"):
        told(mavlink.MAVLink_set_mode_message(1, 1, main << 16), known)


@pytest.mark.parametrize("frame", [1, 2, 4, 7, 8, 9, 10, 12, 20, 21, 255])
@pytest.mark.parametrize("altitude", [NAN, 20.0])
def test_a_position_in_another_frame_is_none_on_the_globe(frame: int, altitude: float) -> None:
    """In a local one these are 10 m north and 20 m east."""
    with pytest.raises(Declined, match=f"frame {frame}") as declined:
        told(int_(192, frame, 100_000, 200_000, altitude))
    assert declined.value.result == UNSUPPORTED
    assert told(int_(192, frame, INT_MAX, INT_MAX, NAN)) == Hold(), "a hold is a hold in any frame"


@pytest.mark.parametrize(
    ("location_ms", "velocity_ms", "is_recent"),
    [(6000, None, True), (29_000, 3000, True), (6001, None, False), (29_000, 6001, False), (None, None, False)],
)
def test_the_altitude_is_kept_only_of_a_drone_that_was_heard_lately(
    location_ms: int | None, velocity_ms: int | None, is_recent: bool
) -> None:
    """One that stands publishes its location every 30 s, its velocity every 3 s."""
    ages: tuple[tuple[State, int | None], ...] = ((HERE, location_ms), (VelocityNed(0.0, 0.0, 0.0), velocity_ms))
    states = {state.name: KnownState(state, age_ms) for state, age_ms in ages if state is HERE or age_ms is not None}
    message = int_(192, RELATIVE, *PLACE, NAN)
    if is_recent:
        assert told(message, View(1, states, 0)) == Goto(47.398, 8.546, 10.0)
        return
    with pytest.raises(Declined, match="reposition without an altitude: the drone's own is not known"):
        told(message, View(1, states, 0))


@pytest.mark.parametrize(
    ("message", "mission", "command"),
    [
        (long(300, 0, 0), None, StartMission(NAMED, 1)),
        (long(300, NAN, 0), None, StartMission(NAMED, 1)),
        (long(300, 3, 0), Mission(2, 1, 6, OTHER), StartMission(NAMED, 4)),
        (ENTER, None, StartMission(NAMED, 1)),
        (ENTER, Mission(3, 2, 6, OTHER), StartMission(NAMED, 1)),
        (ENTER, Mission(3, 2, 6, NAMED), Resume(NAMED)),
        (ENTER, Mission(3, 0, 6, None), Resume(NAMED)),  # the UAV client has restarted
        (ENTER, Mission(1, 0, 6, None), StartMission(NAMED, 1)),
        (long(193, 1), Mission(3, 2, 6, NAMED), Resume(NAMED)),
        (ENTER, Mission(6, 6, 6, NAMED), StartMission(NAMED, 1)),
        (ENTER, Mission(4, 6, 6, NAMED), StartMission(NAMED, 4)),
        (long(224, 0), None, SetCurrentItem(NAMED, 1)),
        (mavlink.MAVLink_mission_set_current_message(1, 1, 4), None, SetCurrentItem(NAMED, 5)),
    ],
)
def test_what_flies_a_mission_names_the_one_that_its_client_means(
    message: Any, mission: Mission | None, command: Command
) -> None:
    known = view(*([] if mission is None else [mission]))
    assert told(message, replace(known, named=NAMED)) == command


def test_without_an_upload_or_a_download_the_mission_that_was_read_last_is_meant() -> None:
    assert told(ENTER, view(Mission(2, 1, 6, OTHER))) == Resume(OTHER)


@pytest.mark.parametrize(
    ("message", "command"),
    [
        (long(300, 0, 0), StartMission(NAMED, 1)),
        (long(300, 1, 0), StartMission(NAMED, 1)),
        (long(300, 4, 0), StartMission(NAMED, 4)),
        (long(224, 2), SetCurrentItem(NAMED, 2)),
        (ENTER_ARDUPILOT, StartMission(NAMED, 1)),
    ],
)
def test_ardupilots_item_0_is_home(message: Any, command: Command) -> None:
    assert told(message, replace(view(autopilot=ARDUPILOT), named=NAMED)) == command


@pytest.mark.parametrize(
    ("message", "result", "text"),
    [
        (long(400, 1, 21_196), 2, "forced"),
        (long(400, 7), 2, "1 to arm"),
        (long(400), 2, "1 to arm"),
        (long(22, 0, 0, 0, 0, 0, 0, 10.0), 2, "home is at 488.0 m; expected 498.0 to fly 10 m above home"),
        (long(22, 0, 0, 0, 0, 0, 0, -1.0), 2, "takeoff to -489.0 m above home: expected more than 0"),
        (int_(22, RELATIVE, 0, 0, -2.0), 2, "takeoff to -2.0 m above home: expected more than 0"),
        (long(176, 1, 3, 0), 2, "mode POSITION"),
        (long(176, 1, 99, 0), 2, "mode UNKNOWN"),
        (long(176, 1, 260, 3), 2, "mode UNKNOWN"),
        (long(176, 1, -252, 3), 2, "mode UNKNOWN"),
        (long(176, 0, 4, 3), 2, "custom mode"),
        (long(176, 1, float("inf"), 0), 2, "custom mode"),
        (mavlink.MAVLink_set_mode_message(1, 0, 0), 2, "custom mode"),
        (long(192, -1, 1, 0, NAN, NAN, NAN, 510.0), 2, "takes a position"),
        (long(192, -1, 1, 0, 0, 0, 0, 0), 2, "0, 0"),
        (int_(192, LOCAL, *PLACE, 5.0), UNSUPPORTED, "frame 1"),
        (long(300, 0, 0), 1, "upload or read it first"),
        (long(300, 2.7), 2, "MISSION_START 2.7.*: expected an item's number"),
        (long(300, -5), 2, "an item's number"),
        (long(300, 65_535), 2, "an item's number"),
        (long(300, float("inf")), 2, "an item's number"),
        (long(300, -float("inf")), 2, "an item's number"),
        (long(176, 1, 4, 4), 1, "upload or read it first"),
        (long(193, 1), 1, "upload or read it first"),
        (long(193, 2), 2, "0 to pause, 1 to continue"),
        (long(224, 1, 1), UNSUPPORTED, "not reset"),
        (long(224, -1), 2, "an item's number"),
        (long(224, 65_535), 2, "an item's number"),
        (long(92, 1), UNSUPPORTED, "set-points"),
        (long(65_000, 1), UNSUPPORTED, "65000"),
        (long(511, 65_000, 1), UNSUPPORTED, "65000"),
        (long(511, NAN, 1), UNSUPPORTED, "None"),
        (long(511, mavlink.MAVLINK_MSG_ID_COMMAND_ACK, 1), UNSUPPORTED, "COMMAND_ACK: it is not streamed"),
        (long(511, mavlink.MAVLINK_MSG_ID_PARAM_VALUE, 1), UNSUPPORTED, "PARAM_VALUE"),
        (long(511, mavlink.MAVLINK_MSG_ID_MISSION_ACK, 1), UNSUPPORTED, "MISSION_ACK"),
        (long(511, mavlink.MAVLINK_MSG_ID_MISSION_ITEM_REACHED, 1), UNSUPPORTED, "MISSION_ITEM_REACHED"),
        (long(511, mavlink.MAVLINK_MSG_ID_LOG_DATA, 1), UNSUPPORTED, "LOG_DATA"),
        (int_(195, ABSOLUTE, *PLACE, 5.0), UNSUPPORTED, "COMMAND_LONG"),
    ],
)
def test_what_cannot_be_meant_is_declined_by_name(message: Any, result: int, text: str) -> None:
    with pytest.raises(Declined, match=text) as declined:
        told(message)
    assert declined.value.result == result


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (long(22, 0, 0, 0, 0, 0, 0, 500.0), "home"),
        (int_(192, ABSOLUTE, *PLACE, 498.0), "home"),
        (int_(192, ABSOLUTE, *PLACE, NAN), "altitude"),
        (long(176, 1, 99, 0), "UNKNOWN"),
    ],
)
def test_without_home_or_place_no_height_is_guessed(message: Any, text: str) -> None:
    with pytest.raises(Declined, match=text):
        told(message, view())


@pytest.mark.parametrize(
    "message",
    [
        long(22, 0, 0, 0, 0, 0, 0, 498.0),
        long(300, 1),
        long(224, 1),
        ENTER,
        mavlink.MAVLink_set_mode_message(1, 1, 9),
    ],
)
def test_without_a_kind_of_autopilot_none_is_guessed(message: Any) -> None:
    """A UAV client that has restarted publishes its `airframe` a moment later than its other states."""
    known = View(1, {state.name: KnownState(state, 100) for state in (HOME, HERE)}, 0, NAMED)
    with pytest.raises(Declined, match="the kind of the drone's autopilot is not known yet") as declined:
        told(message, known)
    assert declined.value.result == NOT_NOW
    assert told(long(21), known) == Land(), "what stops a drone needs no kind"


def test_repetitions_are_equal_though_nan_is_not() -> None:
    assert Request.of(long(22)) == Request.of(long(22))
    assert Request.of(long(22)) != Request.of(long(22, 1))


FLOATS = st.floats(width=32) | st.sampled_from([0.0, 1.0, 4.0, NAN, float("inf"), -float("inf")])
NUMBERS = st.sampled_from([20, 21, 22, 176, 192, 193, 300, 400, 511, 512, 32_100]) | st.integers(0, 2**16 - 1)
KNOWN = st.sampled_from([view(), view(HOME, HERE), view(HOME, HERE, autopilot=ARDUPILOT), View(1, {}, 0)])


@given(NUMBERS, st.tuples(*[FLOATS] * 7), KNOWN)
def test_whatever_a_client_sends_is_a_command_or_declined(number: int, params: tuple[float, ...], known: View) -> None:
    _told_or_declined(long(number, *params), known)


@given(NUMBERS, st.integers(0, 255), st.tuples(*[st.integers(-(2**31), INT_MAX)] * 2), FLOATS, KNOWN)
def test_so_is_whatever_comes_as_integers(
    number: int, frame: int, place: tuple[int, int], z: float, known: View
) -> None:
    _told_or_declined(int_(number, frame, *place, z), known)


@given(st.integers(0, 255), st.integers(0, 2**32 - 1), KNOWN)
def test_so_is_any_mode(base: int, custom: int, known: View) -> None:
    _told_or_declined(mavlink.MAVLink_set_mode_message(1, base, custom), known)


def _told_or_declined(message: Any, known: View) -> None:
    request = Request.of(message)
    answer = Answers(Turns()).on_command(request, known)
    if answer is None:
        with contextlib.suppress(Declined, PayloadError):
            encode(CommandMessage(**IDS, command=command_of(request, known, 10.0)))


IDS: dict[str, Any] = {
    "gs_session": 1,
    "seq": 1,
    "executor_session": 1,
    "deadline_ms": 1,
    "limit_s": 1.0,
    "epoch": 0,
}
