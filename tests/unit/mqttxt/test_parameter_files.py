"""`.params` files as QGroundControl writes them, and the command that reads, writes and compares them."""

from __future__ import annotations

import json
import lzma
import math
from pathlib import Path

import pytest

from mqttxt import ConfigurationError, Parameters
from mqttxt.drone import parameter_ranges
from mqttxt.drone.mavlink.guarded_parameters import GUARDED, is_guarded
from mqttxt.drone.mavlink.raw import Limits
from mqttxt.drone.options import UavOptions
from mqttxt.drone.parameter_file import ParameterFile
from mqttxt.protocol.parameters import Parameter, ParameterSet, ParameterType
from tests.unit.mqttxt.typed import refused

QGC = """# Onboard parameters for Vehicle 1
#
# Stack: PX4 Pro
# Vehicle: Multi-Rotor
# Version: 1.15.4
# Git Revision: 99c40407ff000000
#
# Vehicle-Id Component-Id Name Value Type
1\t1\tBAT1_A_PER_V\t15.391030311584473\t9
1\t1\tMPC_XY_CRUISE\t5.000000000000000000\t9
1\t1\tNAV_DLL_ACT\t-1\t6
1\t1\tODD\tnan\t9
1\t154\tMNT_MODE_IN\t2\t6
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "drone.params"
    path.write_text(QGC)
    return path


def test_a_file_of_qgroundcontrol_is_read(file: Path) -> None:
    found = Parameters.load(file)
    assert [*found] == ["BAT1_A_PER_V", "MPC_XY_CRUISE", "NAV_DLL_ACT", "ODD"]
    assert (found["MPC_XY_CRUISE"], found["NAV_DLL_ACT"], math.isnan(found["ODD"])) == (5.0, -1, True)
    assert found["BAT1_A_PER_V"] == pytest.approx(15.391030311584473, rel=1e-7)
    assert found.content.parameters["NAV_DLL_ACT"].type is ParameterType.INT32


def test_what_is_saved_is_read_as_the_same(file: Path, tmp_path: Path) -> None:
    found, again = Parameters.load(file), tmp_path / "again.params"
    found.save(again, 7)
    assert Parameters.load(again) == found
    assert again.read_text().splitlines()[-1] == "7\t1\tODD\tnan\t9"
    assert "7\t1\tBAT1_A_PER_V\t15.39103\t9" in again.read_text()


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1\t1\tA\tfast\t9", "A: expected a number, got 'fast'"),
        ("1\t1\tA\t1_5\t9", "A: expected a number, got '1_5'"),
        ("1\t1\tA\t１\t9", "A: expected a number, got '１'"),
        ("1\t1\tA\t1.5\t6", "A: expected a whole number from -2147483648 to 2147483647, got 1.5"),
        ("1\t1\tA\t300\t1", "A: expected a whole number from 0 to 255, got 300.0"),
        ("1\t1\tA\tinf\t9", "A: expected a number of at most 3.403e+38 in size, got inf"),
        ("1\t1\tA\tnan\t6", "A: expected a whole number from -2147483648 to 2147483647, got None"),
        ("1\t1\tA\t1\t7", "A: type 7: expected one of 1, 2, 3, 4, 5, 6, 9"),
        ("1\t1\tA\t1", "expected VEHICLE COMPONENT NAME VALUE TYPE, separated by tabs, got '1\\t1\\tA\\t1'"),
        ("1\tx\tA\t1\t9", "component: expected a whole number, got 'x'"),
        ("1\t1\tABCDEFGHIJKLMNOPQ\t1\t9", "ABCDEFGHIJKLMNOPQ: expected a name of 1 to 16 characters"),
        ("1\t1\tODD\t1\t9", "ODD: expected each parameter once"),
    ],
)
def test_each_mistake_is_a_line_with_its_number(file: Path, line: str, said: str) -> None:
    file.write_text(f"{QGC}{line}\n")
    with pytest.raises(ConfigurationError) as error:
        Parameters.load(file)
    assert str(error.value) == f"{file}: line 14: {said}"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"# nothing\n", "no parameters; expected lines of VEHICLE COMPONENT NAME VALUE TYPE, separated by tabs"),
        (b"\xff\xfe", "expected parameters in text, got bytes that are no UTF-8"),
        (b"#" * 1_000_001, "expected at most 1000000 bytes"),
    ],
)
def test_what_is_no_such_file_is_a_line(file: Path, content: bytes, said: str) -> None:
    file.write_bytes(content)
    assert refused("gs", "params", "load", file, "--drone", 1) == f"{file}: {said}"


def test_differences_name_both_values(file: Path) -> None:
    first = Parameters.load(file)
    changed = [one for one in first.content if one.name != "ODD"]
    changed[1] = Parameter("MPC_XY_CRUISE", ParameterType.REAL32, 6.5)
    found = first.differences(Parameters(ParameterSet.of([*changed, Parameter("NEW", ParameterType.INT8, 1)])))
    assert [str(one) for one in found] == ["MPC_XY_CRUISE: 5 and 6.5", "NEW: - and 1", "ODD: nan and -"]


@pytest.mark.parametrize("value", ["fast", "nan", "inf"])
def test_a_value_that_is_no_number_is_a_line(value: str) -> None:
    said = refused("gs", "params", "set", "MPC_XY_CRUISE", value, "--drone", 1)
    assert said == f"set_parameter value '{value}': expected a finite number"


@pytest.mark.parametrize(
    "name",
    [
        *("MAV_SYS_ID", "SYSID_THISMAV", "SYSID_MYGCS", "CBRK_FLIGHTTERM", "NAV_DLL_ACT", "FS_THR_ENABLE", "GF_ACTION"),
        *("FENCE_ENABLE", "BATT2_FS_LOW_ACT", "CAL_GYRO0_ID", "SERVO1_FUNCTION", "MAV_0_CONFIG", "SERIAL1_BAUD"),
        # the pilot's switches, and sticks
        *("RC_KILLSWITCH_TH", "RC_ARMSWITCH_TH", "RC_MAP_KILL_SW", "RC5_REV", "COM_FLTMODE1", "MAN_KILL_GEST_T"),
        *("RC7_OPTION", "RC12_OPTION", "RC7_REVERSED", "FLTMODE1", "FLTMODE_CH", "FLTMODE_GCSBLOCK"),
        *("COM_RC_OVERRIDE", "COM_RC_STICK_OV", "COM_RC_IN_MODE", "RC_FAILS_THR", "RC3_MIN", "RC_OVERRIDE_TIME"),
        *("RC_OPTIONS", "RC_PROTOCOLS", "RCMAP_THROTTLE", "SYSID_ENFORCE", "MAV_OPTIONS"),
        # what the battery's failsafes see
        *("BAT_CRIT_THR", "BAT_EMERGEN_THR", "BAT_LOW_THR", "BAT1_SOURCE", "BAT3_SOURCE", "BAT1_V_EMPTY"),
        *("BATT_LOW_VOLT", "BATT_LOW_MAH", "BATT_CRT_VOLT", "BATT_CRT_MAH", "BATT_MONITOR", "BATT_CAPACITY"),
        *("BATT2_CRT_VOLT", "BATT9_MONITOR", "BATTA_LOW_MAH"),
        # other failsafes and checks
        *("COM_ACT_FAIL_ACT", "COM_POS_FS_EPH", "COM_WIND_MAX", "COM_FLTT_LOW_ACT", "COM_RC_LOSS_T", "FS_THR_VALUE"),
        *("COM_ARMABLE", "SYS_HAS_GPS", "COM_LKDOWN_TKO", "SYS_FAILURE_EN", "SYS_HITL"),
    ],
)
def test_what_endangers_is_guarded(name: str) -> None:
    assert is_guarded(name)
    assert is_guarded(name.lower())


@pytest.mark.parametrize("name", ["MPC_XY_CRUISE", "RTL_RETURN_ALT", "RTL_ALT", "WPNAV_SPEED", "MIS_TAKEOFF_ALT"])
def test_what_does_not_is_not(name: str) -> None:
    assert not is_guarded(name)


def test_only_what_is_guarded_can_be_enabled() -> None:
    UavOptions(limits=Limits(parameters=frozenset({"MAV_SYS_ID"})))
    with pytest.raises(ConfigurationError, match=r"^--allow-parameter MPC_XY_CRUISE: expected one that is guarded: "):
        UavOptions(limits=Limits(parameters=frozenset({"MPC_XY_CRUISE"})))
    assert all(reason for reason in GUARDED.values())


def test_a_set_is_kept_on_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "drone1.parameters"
    some = ParameterSet.of([Parameter("A", ParameterType.INT8, 1)])
    ParameterFile(path).keep(some)
    assert ParameterFile(path).kept == some


@pytest.mark.parametrize("content", [b"", b"nonsense", b"x\x9c"])
def test_a_file_that_is_broken_is_none(tmp_path: Path, content: bytes, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "drone1.parameters"
    path.write_bytes(content)
    assert ParameterFile(path).kept is None
    assert "they are read anew" in caplog.text


PX4_RANGES = {"version": 1, "parameters": [{"name": "A", "min": -1, "max": 2.5}, {"name": "B", "min": 0}]}
ARDUPILOT_RANGES = {"json": {"version": 0}, "A_": {"A_ONE": {"Range": {"low": "0", "high": "10"}}, "A_TWO": {}}}


@pytest.mark.parametrize(
    ("document", "found"), [(PX4_RANGES, {"A": (-1.0, 2.5)}), (ARDUPILOT_RANGES, {"A_ONE": (0.0, 10.0)})]
)
def test_ranges_are_read_of_both_kinds_of_files(tmp_path: Path, document: object, found: object) -> None:
    plain, packed = tmp_path / "ranges.json", tmp_path / "ranges.json.xz"
    plain.write_text(json.dumps(document))
    packed.write_bytes(lzma.compress(plain.read_bytes()))
    assert parameter_ranges.load(plain) == parameter_ranges.load(packed) == found


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.json", b"{"),
        ("a.json", b"[1]"),
        ("a.json", b'{"parameters": 5}'),
        ("a.json", b'{"parameters": []}'),
        ("a.json", b'{"A_": {"A_ONE": {"Range": {"low": "x", "high": "1"}}}}'),
        ("a.json.xz", b"no xz"),
    ],
)
def test_a_file_without_ranges_is_a_line(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ConfigurationError) as error:
        parameter_ranges.load(path)
    said = str(error.value)
    assert said.startswith(f"--parameter-ranges {path}: ")
    assert said.endswith("; expected PX4's parameters.json (also as .xz) or ArduPilot's apm.pdef.json")
    assert "\n" not in said
