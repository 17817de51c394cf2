"""Payloads: both forms carry the same, schemas hold, and nothing that is off gets in (section 3)."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import cbor2
import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mqttxt
from mqttxt.errors import PayloadError
from mqttxt.protocol.cbor import MAX_PAYLOAD, parse_cbor
from mqttxt.protocol.codec import decode, encode, encoding_of
from mqttxt.protocol.commands import COMMAND, Attitude, Goto, Offboard, Stream, Takeoff, Velocity
from mqttxt.protocol.control import DroneLease, Registration
from mqttxt.protocol.identify import identify
from mqttxt.protocol.messages import (
    BeaconMessage,
    By,
    CommandMessage,
    FogPresence,
    FogResultMessage,
    Presence,
    ResultMessage,
    Word,
)
from mqttxt.protocol.state_payload import (
    StampedState,
    decode_state,
    encode_relayed,
    encode_state,
    message_class,
    plain_state,
)
from mqttxt.protocol.states import STATES, Battery, Heading, Location
from mqttxt.protocol.values import Encoding
from mqttxt.security.cose import Envelope
from spec import schema
from tests.examples import examples
from tests.simulation.strategies import PLAIN, messages

SCHEMAS = Path(mqttxt.__file__).parent / "protocol" / "schemas"
JSON_SCHEMA = json.loads((SCHEMAS / "payload-v1.schema.json").read_text())
CDDL = (SCHEMAS / "payload-v1.cddl").read_text()


EVERY = [*schema.MESSAGES, *(message_class(name, relayed) for name in STATES for relayed in (True, False))]
MAVLINK = [message_class(f"mavlink/{name}", True) for name in ("ATTITUDE", "BATTERY_STATUS", "STATUSTEXT", "ODOMETRY")]


@pytest.mark.parametrize("cls", EVERY, ids=lambda cls: cls.__name__)
@examples(40)
@given(data=st.data())
def test_both_forms_give_the_same_message_back_and_follow_their_schemas(cls: type[Any], data: Any) -> None:
    message = data.draw(messages(cls))
    as_cbor, as_json = encode(message), encode(message, Encoding.JSON)
    assert decode(cls, as_cbor) == decode(cls, as_json) == message
    assert (encoding_of(as_cbor), encoding_of(as_json)) == (Encoding.CBOR, Encoding.JSON)
    validator_of(cls).validate(json.loads(as_json))


@pytest.mark.parametrize("cls", MAVLINK, ids=lambda cls: cls.__name__)
@examples(40)
@given(data=st.data())
def test_mavlink_messages_are_the_same_in_both_forms(cls: type[Any], data: Any) -> None:
    message = data.draw(messages(cls))
    assert decode(cls, encode(message)) == decode(cls, encode(message, Encoding.JSON)) == message


@cache
def validator_of(cls: type[Any]) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator({**JSON_SCHEMA, "$ref": f"#/$defs/{cls.__name__}"})


def test_the_schemas_in_the_package_are_made_from_the_messages() -> None:
    assert schema.json_schema() == JSON_SCHEMA, "run python -m spec.schema services/mqttxt/src/mqttxt/protocol/schemas"
    assert schema.cddl() == CDDL


@pytest.mark.parametrize("cls", [*EVERY, *MAVLINK], ids=lambda cls: cls.__name__)
@examples(60)
@given(payload=st.binary(max_size=60))
def test_no_bytes_raise_anything_but_payload_error(cls: type[Any], payload: bytes) -> None:
    for candidate in (payload, b"{" + payload, b"\x88\x01" + payload):
        identify(candidate)
        try:
            decode(cls, candidate)
        except PayloadError:
            continue


@given(PLAIN)
def test_no_cbor_raises_anything_but_payload_error(plain: Any) -> None:
    for cls in (CommandMessage, ResultMessage, FogPresence):
        try:
            decode(cls, cbor2.dumps(plain))
        except PayloadError:
            continue


def _command(**changed: Any) -> dict[str, Any]:
    plain: dict[str, Any] = json.loads(
        encode(
            CommandMessage(
                gs_session=1, seq=2, executor_session=3, deadline_ms=4, limit_s=5.0, command=Takeoff(altitude_m=10)
            ),
            Encoding.JSON,
        )
    )
    return {**plain, **changed}


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"version": 2}, "version: expected 1, got 2"),
        ({"extra": 1}, "fields of Takeoff, got ['extra']"),
        ({"altitude_m": "10"}, "altitude_m: expected a number from 0.5 to 10000"),
        ({"altitude_m": 1e9}, "altitude_m: expected a number from 0.5 to 10000"),
        ({"altitude_m": True}, "altitude_m: expected a number"),
        ({"seq": 1.5}, "seq: expected a whole number from 0 to 4294967295"),
        ({"gs_session": 0}, "gs_session: expected a whole number from 1 to"),
        ({"command": "explode"}, "command: expected a known command, got 'explode'"),
        ({"deadline_ms": -1}, "deadline_ms: expected a whole number"),
    ],
)
def test_what_is_off_is_refused_with_the_field_and_what_was_expected(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(PayloadError) as refusal:
        decode(CommandMessage, json.dumps(_command(**changed)).encode())
    assert said in str(refusal.value)


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"", "got nothing"),
        (b"{" * 40, "not JSON"),
        (b'{"version":1,"session":1,"up":NaN}', "got NaN"),
        (b'{"version":1,"version":1,"session":1,"up":true}', "each field once"),
        (b'{"version":1,"session":1}', "up: expected a value"),
        (b"\x83\x01\x01\xf5\x00", "bytes behind the end"),
        (b"\x82\x01\x01", "up: expected a value"),
        (b"\x86\x01\x01\xf5\x00\xf5\x00", "at most 5 fields"),
        (b"\x9f\x01\x01\xf5\xff", "not CBOR"),
        (b"\x83\x01\xfb\x7f\xf8\x00\x00\x00\x00\x00\x00\xf5", "session: expected a whole number"),
        (b"\x81" * 500, "not CBOR"),
        (b"\x83\x01\x01\xf5" + b"\0" * MAX_PAYLOAD, "at most"),
    ],
)
def test_malformed_payloads_are_refused_with_a_reason(payload: bytes, said: str) -> None:
    with pytest.raises(PayloadError, match=said):
        decode(Presence, payload)


@pytest.mark.parametrize(
    "tagged",
    [
        pytest.param(bytes.fromhex("82 d8 1c 81 01 82 d8 1d 00 d8 1d 00"), id="references to values"),
        pytest.param(bytes.fromhex("d9 0100 82 64 61626364 d8 19 00"), id="references to strings"),
        pytest.param(bytes.fromhex("d8 23 61 61"), id="a regular expression"),
        pytest.param(bytes.fromhex("d8 24 63 613a62"), id="a mail"),
        pytest.param(bytes.fromhex("c2 41 01"), id="a long number"),
        pytest.param(bytes.fromhex("c1 01"), id="a time"),
        pytest.param(bytes.fromhex("d9 ffff 01"), id="a tag that nobody knows"),
    ],
)
def test_what_has_a_tag_is_not_read(tagged: bytes) -> None:
    """Two kilobytes of references say more than a machine can write down; 60 kB of a regular expression take 40 s."""
    for read in (parse_cbor, lambda payload: decode(CommandMessage, payload), Envelope.parse):
        with pytest.raises(PayloadError, match="not CBOR"):
            read(tagged)
    named = b"\x84\x01\x01\x02"
    assert identify(named + b"\x00") == (1, 2)
    assert identify(named + tagged) is None


def test_a_map_of_many_keys_in_a_long_payload_is_not_read() -> None:
    """Keys of one hash take quadratic time, and whoever may publish chooses them; a small payload costs little."""
    key, pairs = b"\x82\x00\x00", 9
    for head in (b"\xa9", b"\xb8\x09", b"\xb9\x00\x09", b"\xba\x00\x00\x00\x09"):
        wide = head + b"".join(key[:2] + bytes((number, 0)) for number in range(pairs))
        for read in (parse_cbor, lambda payload: decode(CommandMessage, payload), Envelope.parse):
            with pytest.raises(PayloadError, match="a map of 9 pairs"):
                read(b"\x82\x59\x08\x00" + bytes(2048) + wide)
        assert identify(b"\x85\x01\x01\x02\x59\x08\x00" + bytes(2048) + wide) is None
    envelope = Envelope(bytes(4096), bytes(4), bytes(64), bytes(2048), [1, {1: 2}])
    assert Envelope.parse(envelope.encode()) == envelope


def test_nan_cannot_be_sent() -> None:
    with pytest.raises(PayloadError):
        encode(message_class("groundspeed", False)(stamp=1, groundspeed_m_s=float("nan")))


def test_states_are_small_and_relayed_ones_carry_both_stamps() -> None:
    assert len(encode_state(StampedState(Battery(87), 4000), Encoding.CBOR)) == 6
    assert len(encode_state(StampedState(Heading(359.99), 4000), Encoding.CBOR)) == 7
    relayed = StampedState(Location(47.397742, 8.545594, 488.0, 10.0), stamp=4000, relay_stamp=17)
    for encoding in Encoding:
        assert decode_state("location", encode_state(relayed, encoding), relayed=True) == relayed
    with pytest.raises(PayloadError):
        decode_state("altimeter", b"\x82\x00\x00", relayed=False)


def test_trailing_nothing_is_left_out() -> None:
    plain = cbor2.loads(encode(ResultMessage(gs_session=1, seq=2, session=3, stamp=4, word=Word.COMPLETED)))
    assert plain == [1, 1, 2, 3, None, 4, 3]
    by = By(gs_session=1, seq=9)
    plain = cbor2.loads(encode(ResultMessage(gs_session=1, seq=2, session=3, stamp=4, word=Word.SUPERSEDED, by=by)))
    assert plain == [1, 1, 2, 3, None, 4, 9, None, None, None, [1, 9]]


def test_cbor_is_integers_in_mavlinks_units() -> None:
    message = CommandMessage(
        gs_session=1, seq=2, executor_session=3, deadline_ms=4, limit_s=5.0, command=Goto(47.5, -8.25, 12.5)
    )
    assert cbor2.loads(encode(message)) == [1, 1, 2, 3, 4, 50, 0, 5, 475_000_000, -82_500_000, 12_500]


def test_a_malformed_command_can_still_be_named() -> None:
    broken = json.dumps(_command(altitude_m="high")).encode()
    assert identify(broken) == (1, 2)
    assert identify(cbor2.dumps([9, 1, 2, "?"])) == (1, 2)
    assert identify(cbor2.dumps([1, 0, 2])) is None
    assert identify(b"\xff") is None


def test_every_command_has_a_name_and_a_limit() -> None:
    assert [(code, name) for code, name, _ in COMMAND.codes] == [
        *[(1, "arm"), (2, "disarm"), (3, "takeoff"), (4, "land"), (5, "goto"), (6, "hold"), (7, "return")],
        *[(8, "offboard"), (9, "stream"), (10, "mavlink"), (11, "upload_plan"), (12, "clear_plan")],
        *[(13, "start_mission"), (14, "pause"), (15, "resume"), (16, "set_current_item"), (17, "set_parameter")],
    ]
    assert Goto(47.5, -8.25, 12.5).limit_s == 900
    assert Stream("mavlink/ATTITUDE", 0.1).limit_s == 30
    assert Offboard(600.0, velocity=Velocity(1, 0, 0)).limit_s > 600


@pytest.mark.parametrize(
    "body",
    [
        [8, 100],
        [8, 100, [100, 0, 0], [0, 0, 0, 500]],
        [8, 0, [100, 0, 0]],
        [8, 36_001, [100, 0, 0]],
        [8, 100, [float("nan"), 0, 0]],
        [8, 100, [10_001, 0, 0]],
        [8, 100, None, [0, 0, 0, 1001]],
        [8, 100, None, [6001, 0, 0, 500]],
        [8, 100, None, [0, 0, 0]],
    ],
)
def test_an_offboard_command_has_one_kind_of_set_point_within_its_ranges(body: list[Any]) -> None:
    with pytest.raises(PayloadError):
        decode(CommandMessage, cbor2.dumps([1, 1, 2, 3, 4, 50, 0, *body]))


def test_offboard_commands_on_the_wire() -> None:
    head = [1, 1, 2, 3, 4, 400, 0]
    fields = {"gs_session": 1, "seq": 2, "executor_session": 3, "deadline_ms": 4, "limit_s": 40.0}
    flown = CommandMessage(**fields, command=Offboard(10.0, velocity=Velocity(1.5, 0, -0.5)))
    assert cbor2.loads(encode(flown)) == [*head, 8, 100, [150, 0, -50]]
    tilted = CommandMessage(**fields, command=Offboard(10.0, attitude=Attitude(0, -5, 90, 0.5)))
    assert cbor2.loads(encode(tilted)) == [*head, 8, 100, None, [0, -500, 9000, 500]]
    assert json.loads(encode(tilted, Encoding.JSON))["attitude"]["thrust"] == 0.5
    with pytest.raises(PayloadError, match="velocity or attitude"):
        Offboard(10.0)


def test_messages_are_what_the_specification_says() -> None:
    lease = DroneLease(activator_session=1, drone_session=2, nonce=3, bound=True)
    assert cbor2.loads(encode(lease)) == [1, 1, 2, 3, True, 0]
    beacon = BeaconMessage(session=1, now_ms=2, nonce=3, held_ms=4)
    assert cbor2.loads(encode(beacon)) == [1, 2, 3, 4]
    registration = Registration(name="g", session=1, nonce=2, lease_s=30)
    assert cbor2.loads(encode(registration)) == [1, "g", 1, 2, 30]
    roster = FogResultMessage(gs_session=1, seq=2, session=3, stamp=4, roster=())
    assert cbor2.loads(encode(roster)) == [1, 1, 2, 3, 4, []]


@pytest.mark.parametrize("name", STATES)
@examples(40)
@given(data=st.data())
def test_a_state_relayed_as_it_came_says_what_one_written_anew_does(name: str, data: Any) -> None:
    form = data.draw(st.sampled_from(Encoding))
    payload = encode(data.draw(messages(message_class(name, False))), form)
    came, passed = decode_state(name, payload, relayed=False), plain_state(name, payload)
    relay_stamp = data.draw(st.integers(0, 2**16 - 1))
    assert (passed.name, passed.state, passed.stamp) == (name, came.state, came.stamp)
    anew = StampedState(came.state, came.stamp, relay_stamp)
    as_it_came = encode_relayed(passed, relay_stamp, Encoding.CBOR)
    assert as_it_came == encode_state(anew, Encoding.CBOR)
    assert decode_state(name, as_it_came, relayed=True) == anew
    as_json = encode_relayed(passed, relay_stamp, Encoding.JSON)
    assert decode_state(name, as_json, relayed=True) == anew
