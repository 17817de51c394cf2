"""Commands as a person types them at `mqttxt gs send`."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.cli.parameters import parse_command
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.commands import (
    COMMANDS,
    Attitude,
    Goto,
    Hold,
    Mavlink,
    Offboard,
    SetParameter,
    Stream,
    Takeoff,
    Velocity,
)


@pytest.mark.parametrize(
    ("typed", "command"),
    [
        ("hold", Hold()),
        ("takeoff", Takeoff()),
        ("takeoff 12.5", Takeoff(12.5)),
        ("goto 47.5 -8 20", Goto(47.5, -8.0, 20.0)),
        ("offboard 5 velocity 1 0 -0.5", Offboard(5.0, velocity=Velocity(1.0, 0.0, -0.5))),
        ("offboard 5 velocity 1 0 0 90", Offboard(5.0, velocity=Velocity(1.0, 0.0, 0.0, 90.0))),
        ("offboard 2 attitude 0 -5 90 0.5", Offboard(2.0, attitude=Attitude(0.0, -5.0, 90.0, 0.5))),
        ("stream mavlink/ATTITUDE 5", Stream("mavlink/ATTITUDE", 5.0)),
        ("mavlink 178 1 - -1", Mavlink(178, (1.0, None, -1.0, None, None, None, None))),
        ("mavlink 203", Mavlink(203, (None,) * 7)),
        ("mavlink do_digicam_control", Mavlink(203, (None,) * 7)),
        ("mavlink MAV_CMD_DO_CHANGE_SPEED 1 - -1", Mavlink(178, (1.0, None, -1.0, None, None, None, None))),
        ("set_parameter NAV_DLL_ACT -1", SetParameter("NAV_DLL_ACT", -1.0)),
        ("mavlink 203 NaN", Mavlink(203, (None,) * 7)),
    ],
)
def test_every_command_can_be_typed(typed: str, command: Any) -> None:
    name, *parameters = typed.split()
    assert parse_command(name, parameters) == command


def test_no_command_is_left_out() -> None:
    for name in COMMANDS:
        try:
            parse_command(name, ["?"] * 9)
        except ConfigurationError as refusal:
            said = str(refusal)
        assert said.startswith(f"{name}: expected "), said


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("hold 1", "hold: expected no parameters, got 1"),
        ("offboard 5", "offboard: expected SECONDS, then velocity or attitude, got 5"),
        ("offboard nan velocity 1 0 0", "offboard duration_s 'nan': expected a number from 0.1 to 3600"),
        ("offboard 5 velocity 1 0", "offboard velocity: expected NORTH_M_S EAST_M_S DOWN_M_S [YAW_DEG], got 1 0"),
        ("offboard 5 attitude 0 0 0 2", "offboard attitude thrust '2': expected a number from 0 to 1"),
        ("stream battery", "stream: expected STATE RATE_HZ, got battery"),
        ("stream battery 51", "stream rate_hz '51': expected a number from 0 to 50"),
        ("mavlink", "mavlink: expected MAV_CMD and up to seven parameters, got nothing"),
        ("mavlink 1.5", "mavlink mav_cmd '1.5': expected a whole number from 0 to 65535"),
        ("mavlink FOO", "mavlink mav_cmd 'FOO': expected a MAV_CMD's name or number"),
        ("mavlink 1 inf", "mavlink param1 'inf': expected a number from -3.40282e+38 to 3.40282e+38"),
    ],
)
def test_what_is_off_is_named(typed: str, said: str) -> None:
    name, *parameters = typed.split()
    with pytest.raises(ConfigurationError) as refusal:
        parse_command(name, parameters)
    assert str(refusal.value) == said
