"""Any message of common.xml as a state, in the order of its fields (section 3)."""

from __future__ import annotations

import json
import math
from typing import Any

import cbor2
import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.errors import PayloadError
from mqttxt.protocol.mavlink_states import kinds, state_of
from mqttxt.protocol.state_payload import StampedState, decode_state, encode_state
from mqttxt.protocol.states import MavlinkState
from mqttxt.protocol.values import Encoding
from tests.simulation.world import from_autopilot


def received(name: str) -> Any:
    """A message of a kind with other than default values, as it comes from a wire."""
    kind = kinds()[name]
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    values = []
    for index, (field, type_name) in enumerate(zip(kind.fieldnames, kind.fieldtypes, strict=True)):
        one: Any = 0.1 * index if type_name in ("float", "double") else index % 100
        if type_name == "char":
            values.append(b"text"[: max(1, lengths[field])])
        else:
            values.append([one] * lengths[field] if lengths[field] else one)
    return from_autopilot(kind(*values))


@pytest.mark.parametrize("name", sorted(kinds()))
@pytest.mark.parametrize("encoding", list(Encoding))
def test_every_message_of_common_travels(name: str, encoding: Encoding) -> None:
    message = received(name)
    sent = StampedState(state_of(message), 7, 8)
    payload = encode_state(sent, encoding)
    assert decode_state(f"mavlink/{name}", payload, relayed=True) == sent
    if encoding is Encoding.CBOR:
        assert len(cbor2.loads(payload)) == 2 + len(message.fieldnames)
    else:
        assert list(json.loads(payload)) == ["relay_stamp", "stamp", *message.fieldnames]


def test_fields_are_in_the_order_of_common_and_floats_are_short() -> None:
    message = from_autopilot(mavlink.MAVLink_attitude_message(1234, 0.1, 0.5, -1.0, 0.0, 0.0, math.nan))
    payload = encode_state(StampedState(state_of(message), 9), Encoding.CBOR)
    plain = cbor2.loads(payload)
    assert plain[:2] == [9, 1234]
    assert plain[2] == pytest.approx(0.1)
    assert plain[3:] == [0.5, -1.0, 0.0, 0.0, None]
    assert len(payload) < 28


def test_what_is_no_number_is_null() -> None:
    message = from_autopilot(mavlink.MAVLink_attitude_message(0, math.nan, math.inf, -math.inf, 0, 0, 0))
    state = state_of(message)
    assert (state.values["roll"], state.values["pitch"], state.values["yaw"]) == (None, None, None)
    assert json.loads(encode_state(StampedState(state, 1), Encoding.JSON))["roll"] is None


def test_arrays_and_texts_are_whole() -> None:
    battery = mavlink.MAVLink_battery_status_message(0, 0, 0, 0, list(range(10)), 0, 0, 0, 55)
    assert state_of(from_autopilot(battery)).values["voltages"] == tuple(range(10))
    text = from_autopilot(mavlink.MAVLink_statustext_message(3, b"Low b\xffttery"))
    assert state_of(text) == MavlinkState(
        "mavlink/STATUSTEXT", {"severity": 3, "text": "Low b\ufffdttery", "id": 0, "chunk_seq": 0}
    )


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("mavlink/NO_SUCH", [1, 2]),
        ("mavlink/HEARTBEAT", [1, 0, 2, 12, 81, 4]),
        ("mavlink/HEARTBEAT", [1, 0, 2, 12, 256, 0, 3, 3]),
        ("mavlink/HEARTBEAT", [1, 0.5, 2, 12, 81, 4, 3, 3]),
        ("mavlink/ATTITUDE", [1, 0, math.nan, 0, 0, 0, 0, 0]),
        ("mavlink/ATTITUDE", [1, 0, math.inf, 0, 0, 0, 0, 0]),
        ("mavlink/ATTITUDE", [1, 0, 1e39, 0, 0, 0, 0, 0]),
        ("mavlink/ATTITUDE", [1, 0, "0", 0, 0, 0, 0, 0]),
        ("mavlink/STATUSTEXT", [1, 3, "x" * 51, 0, 0]),
        ("mavlink/GPS_STATUS", [1, 1, [1], [1] * 20, [1] * 20, [1] * 20, [1] * 20]),
    ],
)
def test_what_does_not_follow_common_is_refused(name: str, plain: list[Any]) -> None:
    with pytest.raises(PayloadError):
        decode_state(name, cbor2.dumps(plain), relayed=False)
