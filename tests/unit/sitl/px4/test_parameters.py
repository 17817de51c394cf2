"""Parameters as PX4 carries them."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from sitl.errors import SitlError
from sitl.fleet import DroneConfig
from sitl.parameters import TYPE_MISMATCH, BytewiseParameters
from sitl.px4.parameters import SPECS
from sitl.vehicle import Vehicle

INT32, REAL32 = mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_REAL32


def test_the_list_has_right_counts_and_indices(drone: Any) -> None:
    hashed, *listed = drone.tell(mavlink.MAVLink_param_request_list_message(1, 1))
    assert (hashed.param_id, hashed.param_index) == ("_HASH_CHECK", 65_535)
    assert [value.param_id for value in listed] == list(SPECS)
    assert [value.param_index for value in listed] == list(range(len(SPECS)))
    assert {value.param_count for value in listed} == {len(SPECS)}


def test_read_by_name_and_by_index(drone: Any) -> None:
    (by_name,) = drone.tell(mavlink.MAVLink_param_request_read_message(1, 1, b"MPC_XY_VEL_MAX", -1))
    (by_index,) = drone.tell(mavlink.MAVLink_param_request_read_message(1, 1, b"", by_name.param_index))
    assert (by_name.param_id, by_name.param_value) == (by_index.param_id, by_index.param_value)
    assert by_name.param_value == 12.0
    for unknown in ((b"NOBODY", -1), (b"", 999)):
        (error,) = drone.tell(mavlink.MAVLink_param_request_read_message(1, 1, *unknown))
        assert error.error == mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST


def test_an_integer_travels_as_its_bytes(drone: Any) -> None:
    as_float = struct.unpack("<f", struct.pack("<i", 3))[0]
    (answer,) = drone.tell(mavlink.MAVLink_param_set_message(1, 1, b"NAV_DLL_ACT", as_float, INT32))
    assert answer.param_type == INT32
    assert struct.pack("<f", answer.param_value) == struct.pack("<i", 3)
    assert drone.autopilot.parameters["NAV_DLL_ACT"] == 3


@pytest.mark.parametrize(
    ("name", "value", "kind"),
    [
        ("MPC_ACC_HOR", -1.0, REAL32),
        ("MPC_ACC_HOR", math.nan, REAL32),
        ("RTL_RETURN_ALT", math.inf, REAL32),
    ],
)
def test_a_set_that_is_out_of_range_is_answered_with_what_stays(drone: Any, name: str, value: float, kind: int) -> None:
    before = drone.autopilot.parameters[name]
    (answer,) = drone.tell(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
    assert answer.param_id == name
    assert drone.autopilot.parameters[name] == before == SPECS[name].default


@pytest.mark.parametrize(("name", "value", "kind"), [("RTL_RETURN_ALT", 20.0, INT32), ("NAV_DLL_ACT", 2.0, REAL32)])
def test_a_set_of_another_type_is_refused(drone: Any, name: str, value: float, kind: int) -> None:
    (answer,) = drone.tell(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
    assert (answer.param_id, answer.error) == (name, TYPE_MISMATCH)
    assert drone.autopilot.parameters[name] == SPECS[name].default


def test_its_own_identity_and_battery_are_its_configurations(drone: Any) -> None:
    assert drone.autopilot.parameters["MAV_SYS_ID"] == 1
    assert drone.autopilot.parameters["BAT1_CAPACITY"] == -1, "PX4's simulated battery has none"
    own = Vehicle(DroneConfig(7, capacity_wh=70.0), ["px4-onboard"]).autopilot.parameters
    assert (own["MAV_SYS_ID"], own["BAT1_CAPACITY"]) == (7, pytest.approx(70 / 14.8 * 1000))


def test_an_override_must_be_possible() -> None:
    with pytest.raises(SitlError, match="parameter MPC_ACC_HOR: expected 2 to 15, got -1"):
        BytewiseParameters(SPECS, {"MPC_ACC_HOR": -1})


@given(st.sampled_from(sorted(SPECS)), st.floats(width=32), st.sampled_from([INT32, REAL32]))
def test_no_set_leaves_a_value_out_of_range(name: str, value: float, kind: int) -> None:
    parameters = BytewiseParameters(SPECS)
    parameters.on_message(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
    assert SPECS[name].low <= parameters[name] <= SPECS[name].high
