"""The MAVLink layers: what pymavlink writes is read, what they write is the same bytes."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v10 import common as version1
from pymavlink.dialects.v20 import common as dialect_of_common
from pymavlink.dialects.v20 import development as dialect
from scapy.error import Scapy_Exception
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.packet import Raw

from testbed.numbers.dissect import mavlink

_LIMITS = {
    kind: (-(2 ** (8 * size - 1)), 2 ** (8 * size - 1) - 1) if signed else (0, 2 ** (8 * size) - 1)
    for size in (1, 2, 4, 8)
    for kind, signed in ((f"int{8 * size}_t", True), (f"uint{8 * size}_t", False))
}


def _values(kind: str, count: int) -> st.SearchStrategy[Any]:
    if kind == "char":
        return st.binary(min_size=count or 1, max_size=count or 1)
    one: st.SearchStrategy[Any]
    if kind in ("float", "double"):
        one = st.floats(width=32 if kind == "float" else 64, allow_nan=False)
    else:
        one = st.integers(*_LIMITS[kind])
    return st.lists(one, min_size=count, max_size=count) if count else one


Made = tuple[Any, dict[str, Any]]


@st.composite
def messages(draw: st.DrawFn, module: Any = dialect) -> Made:
    """pymavlink's class of a message of common.xml, and arbitrary values for it."""
    table = module.mavlink_map[draw(st.sampled_from(sorted(module.mavlink_map)))]
    counts = dict(zip(table.ordered_fieldnames, table.array_lengths, strict=True))
    kinds = dict(zip(table.fieldnames, table.fieldtypes, strict=True))
    return table, {name: draw(_values(kinds[name], counts[name])) for name in table.fieldnames}


def writer(module: Any = dialect) -> Any:
    made = module.MAVLink(None, srcSystem=3, srcComponent=1)
    made.seq = 77
    return made


@given(messages())
def test_what_pymavlink_writes_is_read_and_written_as_it_was(made: Made) -> None:
    table, values = made
    data = table(**values).pack(writer())
    frame = mavlink.MAVLink(data)
    assert (frame.sysid, frame.compid, frame.seq, frame.msgid) == (3, 1, 77, table.id)
    assert type(frame.message).__name__ == table.msgname
    assert {name: frame.message.getfieldval(name) for name in values} == values
    assert frame.checksum_is_right
    own = mavlink.message_of(table.msgname)(**values)
    assert bytes(mavlink.MAVLink2(seq=77, sysid=3, compid=1, message=own)) == data


@given(messages(version1))
def test_a_frame_of_version_1_has_no_extensions_and_keeps_its_zeros(made: Made) -> None:
    table, values = made
    data = table(**values).pack(writer(version1))
    frame = mavlink.MAVLink(data)
    assert isinstance(frame, mavlink.MAVLink1)
    assert frame.msgid == table.id
    known = mavlink.message_class(table.id)
    assert known is not None
    assert {name: frame.message.getfieldval(name) for name in values} == values
    assert bytes(mavlink.MAVLink1(seq=77, sysid=3, compid=1, message=known(**values))) == data


@given(messages())
def test_what_the_layers_write_pymavlink_reads(made: Made) -> None:
    table, values = made
    own = mavlink.message_of(table.msgname)(**values)
    (read,) = dialect.MAVLink(None).parse_buffer(bytes(mavlink.MAVLink2(message=own)))
    assert (read.get_type(), read.get_srcSystem(), read.get_srcComponent()) == (table.msgname, 255, 190)
    raw = {name: getattr(read, f"_{name}_raw", getattr(read, name)) for name in values}
    assert {name: _text(value) for name, value in raw.items()} == {name: _text(value) for name, value in values.items()}


def _text(value: Any) -> Any:
    """A text up to its first zero, where pymavlink cuts most of them; anything else as it is."""
    return value.split(b"\0")[0] if isinstance(value, bytes) else value


def test_every_message_of_common_xml_is_the_same_in_the_tables_used() -> None:
    for number, common in dialect_of_common.mavlink_map.items():
        table = dialect.mavlink_map[number]
        assert (table.msgname, table.ordered_fieldnames, table.fieldtypes, table.crc_extra, table.unpacker.format) == (
            *(common.msgname, common.ordered_fieldnames, common.fieldtypes, common.crc_extra, common.unpacker.format),
        )


def test_every_message_has_a_class_with_its_fields() -> None:
    for number, table in dialect.mavlink_map.items():
        made = mavlink.message_class(number)
        assert made is not None
        assert made.__name__ == table.msgname
        assert [field.name for field in made.fields_desc] == table.ordered_fieldnames
        assert sum(field.sz for field in made.fields_desc) == table.unpacker.size
    assert mavlink.HEARTBEAT is mavlink.message_class(0)


@given(st.binary(max_size=60) | st.builds(lambda rest: b"\xfd" + rest, st.binary(max_size=300)))
def test_no_bytes_raise_and_none_is_lost(data: bytes) -> None:
    packet = Ether(bytes(Ether() / IP() / UDP(sport=1, dport=2) / Raw(data)))
    read = mavlink.MAVLink(data)
    assert bytes(read) == data
    assert bytes(packet[UDP].payload) == data


def test_a_frame_that_is_cut_off_is_raw() -> None:
    data = bytes(mavlink.MAVLink2(message=mavlink.HEARTBEAT(type=2)))
    assert type(mavlink.MAVLink(data[:-1])) is Raw
    both = mavlink.MAVLink(data + data[:-1])
    assert type(both.payload) is Raw
    assert bytes(both) == data + data[:-1]


def test_a_message_that_the_tables_do_not_have_is_raw_and_kept() -> None:
    data = bytes(mavlink.MAVLink2(msgid=9_999_999, message=Raw(b"abc"), checksum=0x1234))
    frame = mavlink.MAVLink(data)
    assert (frame.msgid, frame.message.load, frame.checksum) == (9_999_999, b"abc", 0x1234)
    assert frame.checksum_is_right is None
    with pytest.raises(Scapy_Exception, match=r"message 9999999 is not in pymavlink's tables: give its checksum"):
        bytes(mavlink.MAVLink2(msgid=9_999_999, message=Raw(b"abc")))


def test_bytes_of_extensions_that_the_table_does_not_know_are_kept_behind_the_message() -> None:
    whole = mavlink.HEARTBEAT(type=2, mavlink_version=3) / Raw(b"new")
    frame = mavlink.MAVLink(bytes(mavlink.MAVLink2(message=whole)))
    assert frame.len == 12
    assert frame[mavlink.HEARTBEAT].type == 2
    assert frame.message.payload.load == b"new"


def test_a_sender_that_does_not_leave_zeros_out_is_written_as_it_was() -> None:
    frame = mavlink.MAVLink(bytes(mavlink.MAVLink2(len=9, message=mavlink.HEARTBEAT())))
    assert frame.len == 9
    frame.message.type = 0  # forgets the bytes that it came with
    assert len(bytes(frame)) == 10 + 9 + 2


def test_a_signed_frame_keeps_its_signature() -> None:
    signing = writer()
    signing.signing.secret_key = b"k" * 32
    signing.signing.sign_outgoing = True
    signing.signing.link_id = 5
    data = dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(signing) * 2
    frame = mavlink.MAVLink(data)
    assert (frame.link_id, len(frame.signature), frame.checksum_is_right) == (5, 6, True)
    assert isinstance(frame.payload, mavlink.MAVLink2)
    assert bytes(frame) == data


def test_a_checksum_that_does_not_fit_is_said() -> None:
    data = bytearray(bytes(mavlink.MAVLink2(message=mavlink.ATTITUDE(roll=0.5))))
    data[12] ^= 1
    assert mavlink.MAVLink(bytes(data)).checksum_is_right is False


def test_a_changed_field_gives_a_new_checksum_once_the_old_one_is_deleted() -> None:
    frame = mavlink.MAVLink(bytes(mavlink.MAVLink2(message=mavlink.ATTITUDE(roll=0.5))))
    frame.message.roll = 0.25
    del frame.checksum, frame.len
    assert mavlink.MAVLink(bytes(frame)).message.roll == 0.25
    assert mavlink.MAVLink(bytes(frame)).checksum_is_right


def test_values_are_taken_and_shown_by_their_names_and_units() -> None:
    frame = mavlink.MAVLink2(
        message=mavlink.HEARTBEAT(type="MAV_TYPE_QUADROTOR", base_mode=0x81),
        sysid=1,
    ) / mavlink.MAVLink2(message=mavlink.COMMAND_LONG(command="MAV_CMD_NAV_TAKEOFF", param7=float("nan")))
    shown = mavlink.MAVLink(bytes(frame)).show(dump=True)
    for line in (
        "msgid     = 0 (HEARTBEAT)",
        "type      = 2 (MAV_TYPE_QUADROTOR)",
        "0x81 (MAV_MODE_FLAG_CUSTOM_MODE_ENABLED+MAV_MODE_FLAG_SAFETY_ARMED)",
        "command   = 22 (MAV_CMD_NAV_TAKEOFF)",
        "param7    = nan",
    ):
        assert line in shown
    assert frame[mavlink.COMMAND_LONG].command == 22
    assert "cA" in mavlink.BATTERY_STATUS().show(dump=True)
    with pytest.raises(ValueError, match="type: 'MAV_TYPE_PIG': expected a number or one of MAV_TYPE_GENERIC"):
        mavlink.HEARTBEAT(type="MAV_TYPE_PIG")


def test_the_code_that_scapy_makes_of_a_frame_makes_it_again() -> None:
    frame = mavlink.MAVLink(bytes(mavlink.MAVLink2(message=mavlink.COMMAND_LONG(command=400, param1=1))))
    names = {"MAVLink2": mavlink.MAVLink2, "COMMAND_LONG": mavlink.COMMAND_LONG}
    assert bytes(eval(frame.command(), names)) == bytes(frame)
    assert '"command": 400' in frame.json()


def test_ports_are_dissected_only_when_asked_for() -> None:
    data = bytes(
        Ether()
        / IP(src="1.2.3.4", dst="5.6.7.8")
        / UDP(sport=9, dport=14541)
        / Raw(bytes(mavlink.MAVLink2(message=mavlink.HEARTBEAT())) * 2)
    )
    assert type(Ether(data)[UDP].payload) is Raw
    mavlink.bind()
    try:
        packet = Ether(data)
        assert mavlink.HEARTBEAT in packet
        assert packet.lastlayer().summary() == "MAVLink 2 255:190 HEARTBEAT"
    finally:
        mavlink.unbind()
    assert type(Ether(data)[UDP].payload) is Raw


def test_texts_and_arrays_are_filled_up_and_limited() -> None:
    frame = mavlink.MAVLink(bytes(mavlink.MAVLink2(message=mavlink.STATUSTEXT(text="low"))))
    assert frame.message.text == b"low".ljust(50, b"\0")
    assert "text      = 'low'" in frame.show(dump=True)
    assert mavlink.BATTERY_STATUS(voltages=[1]).voltages == [1] + [0] * 9
    with pytest.raises(ValueError, match="voltages: expected at most 10 values, got 11"):
        mavlink.BATTERY_STATUS(voltages=[1] * 11)
    with pytest.raises(AttributeError, match=r"HEARTBEET: no message of pymavlink's tables"):
        mavlink.message_of("HEARTBEET")
