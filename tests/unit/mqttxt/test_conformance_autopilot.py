"""The conformance kit's autopilot: its signatures, parameters and logs are those that a UAV client expects."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.mavlink.parameter_protocol import parameter_of, set_message
from mqttxt.drone.mavlink.signing import NotTrusted, Signing
from mqttxt.drone.mavlink.stamps import Stamps
from mqttxt.protocol.parameters import Parameter, ParameterType
from mqttxt_conformance.autopilot_keeps import INT32, REAL32, Logs, Parameters, as_float, as_value
from mqttxt_conformance.mavlink_signing import Signer, signature

KEY = bytes(range(1, 33))


def told(message: Any, signer: Signer | None = None) -> Any:
    """The message as it comes out of the wire."""
    encoder = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    if signer is not None:
        signer.equip(encoder)
    (found,) = mavlink.MAVLink(None).parse_buffer(message.pack(encoder))
    return found


def beat() -> Any:
    return mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3)


def test_what_a_signer_signs_is_trusted_and_what_is_old_or_anothers_is_not() -> None:
    own, signing = Signer(KEY), Signing(KEY, Stamps())
    first, second = told(beat(), own), told(beat(), own)
    assert signing.judge(first, 1.0) is first
    assert signing.judge(second, 1.1) is second
    for stranger in (None, Signer(bytes(32)), Signer(KEY, late_s=5), Signer(KEY, link_id=2)):
        assert isinstance(signing.judge(told(beat(), stranger), 1.2), NotTrusted)


def test_a_signature_is_read_as_its_link_id_and_a_time_stamp_that_rises() -> None:
    signer = Signer(KEY, link_id=7)
    stamps = []
    for _ in range(3):
        found = signature(told(beat(), signer), KEY)
        assert found is not None
        assert found[0] == 7
        stamps.append(found[1])
    assert stamps == sorted(set(stamps))
    assert signature(told(beat(), signer), bytes(32)) is None
    assert signature(told(beat()), KEY) is None


@pytest.mark.parametrize(("kind", "value"), [(INT32, 3), (INT32, -1_000_000), (REAL32, 2.5)])
def test_a_parameters_value_is_carried_as_a_px4_carries_it(kind: int, value: float) -> None:
    assert as_value(kind, as_float(kind, value)) == value
    keeps = Parameters({"A": (kind, 0), "B": (kind, value)})
    one = Parameter("B", ParameterType(kind), value)
    (answer,) = keeps.answers(told(mavlink.MAVLink_param_request_read_message(1, 1, b"B", -1)))
    assert parameter_of(told(answer), bytewise=True) == one
    keeps.answers(told(set_message(1, Parameter("A", ParameterType(kind), value), bytewise=True)))
    assert keeps.values["A"] == (kind, value)


def test_a_list_has_every_parameter_with_its_index_and_an_unknown_one_is_not_answered() -> None:
    keeps = Parameters({"B": (REAL32, 2.0), "A": (REAL32, 1.0)})
    listed = keeps.answers(told(mavlink.MAVLink_param_request_list_message(1, 1)))
    assert [(one.param_index, one.param_count, one.param_value) for one in listed] == [(0, 2, 1.0), (1, 2, 2.0)]
    assert keeps.answers(told(mavlink.MAVLink_param_request_read_message(1, 1, b"C", -1))) == []
    assert keeps.answers(told(mavlink.MAVLink_param_request_read_message(1, 1, b"", 5))) == []


def test_a_log_is_told_in_pieces_up_to_its_end() -> None:
    logs = Logs({4: (1_700_000_000, bytes(range(200)))})
    (entry,) = logs.answers(told(mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF)))
    assert (entry.id, entry.num_logs, entry.size, entry.time_utc) == (4, 1, 200, 1_700_000_000)
    pieces = logs.answers(told(mavlink.MAVLink_log_request_data_message(1, 1, 4, 90, 900)))
    assert [(one.ofs, one.count) for one in pieces] == [(90, 90), (180, 20)]
    assert logs.answers(told(mavlink.MAVLink_log_request_data_message(1, 1, 5, 0, 90))) == []
