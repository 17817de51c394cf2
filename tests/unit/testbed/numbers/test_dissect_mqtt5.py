"""The MQTT 5 layers: what paho and mqttxt write is read, every packet type makes the round trip."""

from __future__ import annotations

import socket
import threading
from typing import Any

import paho.mqtt.client as paho
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions
from scapy.layers.inet import IP, TCP
from scapy.layers.l2 import Ether
from scapy.packet import Packet, Raw
from scapy.sessions import TCPSession

from testbed.numbers.dissect import mqtt5
from testbed.numbers.dissect.mqtt5_codes import DISCONNECT_REASONS, REASONS, SUBSCRIBE_REASONS, TYPES
from testbed.numbers.dissect.mqtt5_fields import (
    PROPERTIES,
    MalformedError,
    read_variable,
    write_variable,
)

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
_VALUES: dict[str, st.SearchStrategy[Any]] = {
    "byte": st.integers(0, 255),
    "two": st.integers(0, 65_535),
    "four": st.integers(0, 2**32 - 1),
    "variable": st.integers(0, 268_435_455),
    "text": TEXT,
    "binary": st.binary(max_size=12),
    "pair": st.tuples(TEXT, TEXT),
}
PROPERTY = st.sampled_from(sorted(PROPERTIES.values())).flatmap(lambda it: st.tuples(st.just(it[0]), _VALUES[it[1]]))
LISTS = st.lists(PROPERTY, max_size=4)
NUMBER = st.integers(1, 65_535)


def _acknowledgement(kind: type[Packet]) -> st.SearchStrategy[Packet]:
    return st.builds(kind, packet_id=NUMBER, reason_code=st.sampled_from(sorted(REASONS)), properties=LISTS)


def _ending(kind: type[Packet]) -> st.SearchStrategy[Packet]:
    return st.builds(kind, reason_code=st.sampled_from(sorted(REASONS)), properties=LISTS)


def _codes() -> st.SearchStrategy[list[int]]:
    return st.lists(st.sampled_from(sorted(SUBSCRIBE_REASONS)), min_size=1, max_size=3)


PACKETS: st.SearchStrategy[Packet] = st.one_of(
    st.builds(mqtt5.Connect, client_id=TEXT, clean_start=st.integers(0, 1), properties=LISTS),
    st.builds(
        mqtt5.Connect,
        will_flag=st.just(1),
        will_qos=st.integers(0, 2),
        will_topic=TEXT,
        will_message=st.binary(max_size=9),
        will_properties=LISTS,
        user_name_flag=st.just(1),
        user_name=TEXT,
        password_flag=st.just(1),
        password=st.binary(max_size=9),
    ),
    st.builds(
        mqtt5.Connack, session_present=st.integers(0, 1), reason_code=st.sampled_from(sorted(REASONS)), properties=LISTS
    ),
    st.builds(
        mqtt5.Publish,
        dup=st.integers(0, 1),
        retain=st.integers(0, 1),
        topic=TEXT,
        properties=LISTS,
        message=st.binary(max_size=200),
    ),
    st.builds(mqtt5.Publish, qos=st.integers(1, 2), packet_id=NUMBER, topic=TEXT, properties=LISTS),
    *(_acknowledgement(kind) for kind in (mqtt5.Puback, mqtt5.Pubrec, mqtt5.Pubrel, mqtt5.Pubcomp)),
    st.builds(
        mqtt5.Subscribe,
        packet_id=NUMBER,
        properties=LISTS,
        subscriptions=st.lists(
            st.builds(
                mqtt5.Subscription,
                filter=TEXT,
                qos=st.integers(0, 2),
                no_local=st.integers(0, 1),
                retain_as_published=st.integers(0, 1),
                retain_handling=st.integers(0, 2),
            ),
            min_size=1,
            max_size=3,
        ),
    ),
    st.builds(mqtt5.Suback, packet_id=NUMBER, properties=LISTS, reason_codes=_codes()),
    st.builds(mqtt5.Unsubscribe, packet_id=NUMBER, properties=LISTS, filters=st.lists(TEXT, min_size=1, max_size=3)),
    st.builds(mqtt5.Unsuback, packet_id=NUMBER, properties=LISTS, reason_codes=_codes()),
    st.builds(mqtt5.Pingreq),
    st.builds(mqtt5.Pingresp),
    _ending(mqtt5.Disconnect),
    _ending(mqtt5.Auth),
)


def shown(packet: Packet) -> dict[str, Any]:
    """A packet's values without its length, as bytes where they are packets."""
    values = {field.name: packet.getfieldval(field.name) for field in packet.fields_desc if field.name != "len"}
    return {
        name: [bytes(v) if isinstance(v, Packet) else v for v in value] if isinstance(value, list) else value
        for name, value in values.items()
    }


@given(PACKETS, PACKETS)
def test_packets_behind_each_other_are_read_as_they_were_written(first: Packet, second: Packet) -> None:
    data = bytes(first) + bytes(second)
    read = mqtt5.MQTT(data)
    assert [type(read), type(read.payload)] == [type(first), type(second)]
    assert shown(read) == shown(first)
    assert shown(read.payload) == shown(second)
    assert "malformed" not in read.fields
    assert bytes(read) == data == bytes(first / second)
    again = type(read)(**{name: value for name, value in read.fields.items() if name != "len"})
    assert bytes(again) == bytes(first)


@given(st.binary(max_size=80))
def test_no_bytes_raise_and_none_is_lost(data: bytes) -> None:
    assert bytes(mqtt5.MQTT(data)) == data


@given(PACKETS, st.data())
def test_a_packet_whose_bytes_are_changed_does_not_raise_and_loses_none(packet: Packet, data: st.DataObject) -> None:
    changed = bytearray(bytes(packet))
    changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    read = mqtt5.MQTT(bytes(changed))
    assert bytes(read) == changed
    assert read.show(dump=True)


@given(st.integers(0, 268_435_455))
def test_variable_byte_integers_are_as_short_as_they_can_be(value: int) -> None:
    written = write_variable(value)
    assert read_variable(b"x" + written, 1) == (value, 1 + len(written))
    assert len(written) == 1 + (value > 127) + (value > 16_383) + (value > 2_097_151)


def test_names_and_forms_of_properties_are_pahos() -> None:
    known = Properties(PacketTypes.PUBLISH)
    assert {number: name for number, (name, _) in PROPERTIES.items()} == {
        number: name.lower().replace(" ", "_") for name, number in known.names.items()
    }
    forms = dict(enumerate(known.types))
    expected = {
        **{"byte": "Byte", "two": "Two Byte Integer", "four": "Four Byte Integer", "variable": "Variable Byte Integer"},
        **{"text": "UTF-8 Encoded String", "binary": "Binary Data", "pair": "UTF-8 String Pair"},
    }
    assert {number: expected[kind] for number, (_, kind) in PROPERTIES.items()} == {
        number: forms[kind] for number, (kind, _) in known.properties.items()
    }


OTHERWISE = {0x11, 0x9E, 0xA2}
"""Reason codes that paho words otherwise than the specification."""


def test_every_reason_code_of_paho_has_its_name() -> None:
    found: dict[int, set[str]] = {}
    for number, kinds in ReasonCode(PacketTypes.CONNACK).names.items():
        found[number] = {name.lower() for name in kinds}
    assert found.keys() == (REASONS | SUBSCRIBE_REASONS).keys()
    for number, names in found.items():
        own = {table.get(number, "").lower() for table in (REASONS, SUBSCRIBE_REASONS, DISCONNECT_REASONS)} - {""}
        assert number in OTHERWISE or own == names


def test_names_of_the_fifteen_packet_types_are_pahos() -> None:
    assert list(TYPES.values()) == [name.upper() for name in PacketTypes.Names[1:16]]
    assert sorted(mqtt5.KINDS) == sorted(TYPES)


def _said_by_paho() -> bytes:
    """What a real client of paho sends from CONNECT to DISCONNECT."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        heard = bytearray()

        def hear() -> None:
            connection, _ = server.accept()
            with connection:
                while data := connection.recv(65_536):
                    heard.extend(data)

        listener = threading.Thread(target=hear)
        listener.start()
        client = paho.Client(paho.CallbackAPIVersion.VERSION2, "drone3", protocol=paho.MQTTv5)
        client.username_pw_set("me", "secret")
        will = Properties(PacketTypes.WILLMESSAGE)
        will.WillDelayInterval = 4
        client.will_set("drone3/reachable", b"gone", qos=1, retain=True, properties=will)
        settings = Properties(PacketTypes.CONNECT)
        settings.SessionExpiryInterval = 30
        settings.UserProperty = ("a", "b")
        client.connect("127.0.0.1", server.getsockname()[1], keepalive=7, clean_start=True, properties=settings)
        client.subscribe([("a/#", SubscribeOptions(qos=1, noLocal=True, retainHandling=2)), ("b", SubscribeOptions())])
        alias, expiring = Properties(PacketTypes.PUBLISH), Properties(PacketTypes.PUBLISH)
        alias.TopicAlias = expiring.TopicAlias = 3
        expiring.MessageExpiryInterval = 5
        client.publish("drone3/state/battery", b"\x82\x01\x02", properties=alias)
        client.publish("", b"x", qos=1, retain=True, properties=expiring)
        client.unsubscribe(["a/#", "b"])
        end = Properties(PacketTypes.DISCONNECT)
        end.ReasonString = "enough"
        client.disconnect(ReasonCode(PacketTypes.DISCONNECT, identifier=4), end)
        listener.join(10)
        assert not listener.is_alive()
        return bytes(heard)


def test_what_paho_says_is_read() -> None:
    data = _said_by_paho()
    read = mqtt5.MQTT(data)
    connect, subscribe, first, second, unsubscribe, disconnect = read.iterpayloads()
    assert (connect.client_id, connect.keep_alive, connect.will_topic) == ("drone3", 7, "drone3/reachable")
    assert (connect.will_message, connect.will_qos, connect.will_retain) == (b"gone", 1, 1)
    assert connect.will_properties == [("will_delay_interval", 4)]
    assert connect.properties == [("session_expiry_interval", 30), ("user_property", ("a", "b"))]
    assert (connect.user_name, connect.password) == ("me", b"secret")
    options = [(it.filter, it.qos, it.no_local, it.retain_handling) for it in subscribe.subscriptions]
    assert options == [("a/#", 1, 1, 2), ("b", 0, 0, 0)]
    assert (first.topic, first.qos, first.message) == ("drone3/state/battery", 0, b"\x82\x01\x02")
    assert (second.topic, second.qos, second.retain, second.message) == ("", 1, 1, b"x")
    assert sorted(second.properties) == [("message_expiry_interval", 5), ("topic_alias", 3)]
    assert unsubscribe.filters == ["a/#", "b"]
    assert (disconnect.reason_code, disconnect.properties) == (4, [("reason_string", "enough")])
    assert "reason_code= Disconnect with Will Message" in read.show(dump=True)
    assert bytes(read) == data
    aliases: dict[int, str] = {}
    assert [mqtt5.topic_of(publish, aliases) for publish in (first, second)] == ["drone3/state/battery"] * 2


def test_an_alias_that_the_capture_does_not_explain_has_no_topic() -> None:
    assert mqtt5.topic_of(mqtt5.Publish(properties={"topic_alias": 9}), {3: "a"}) == ""


def test_an_acknowledgement_leaves_out_what_says_nothing() -> None:
    assert bytes(mqtt5.Puback(packet_id=7)).hex() == "40020007"
    assert bytes(mqtt5.Puback(packet_id=7, reason_code=0x10)).hex() == "4003000710"
    assert bytes(mqtt5.Disconnect()).hex() == "e000"
    assert mqtt5.MQTT(bytes.fromhex("4003000700")).reason_code == 0
    assert bytes(mqtt5.Pubrel(packet_id=7, len=4)).hex() == "620400070000"


def test_bytes_that_a_type_does_not_explain_are_named() -> None:
    read = mqtt5.MQTT(bytes.fromhex("c003010203c000"))
    assert (type(read), read.malformed, type(read.payload)) == (mqtt5.Pingreq, b"\1\2\3", mqtt5.Pingreq)
    unknown = mqtt5.MQTT(bytes.fromhex("3007000161") + bytes.fromhex("03550102"))
    assert unknown.properties == [("malformed", b"\x55\1\2")]
    assert bytes(mqtt5.Publish(topic="a", properties=unknown.properties)) == bytes(unknown)
    with pytest.raises(MalformedError, match="property 'colour': expected one of payload_format_indicator"):
        bytes(mqtt5.Publish(properties={"colour": 1}))


def _segment(body: bytes, seq: int) -> Packet:
    headers = Ether() / IP(src="1.2.3.4", dst="5.6.7.8") / TCP(sport=9, dport=1883, seq=seq, flags="PA")
    return Ether(bytes(headers / Raw(body)))


def test_ports_are_dissected_only_when_asked_for_and_streams_are_put_together() -> None:
    whole = bytes(mqtt5.Publish(topic="a/b", message=b"1" * 50) / mqtt5.Pingreq() / mqtt5.Puback(packet_id=5))
    assert type(_segment(whole, 1)[TCP].payload) is Raw
    mqtt5.bind()
    try:
        assert [type(layer) for layer in _segment(whole, 1)[mqtt5.Publish].iterpayloads()] == [
            mqtt5.Publish,
            mqtt5.Pingreq,
            mqtt5.Puback,
        ]
        assert type(_segment(whole[:20], 1)[TCP].payload) is Raw
        session = TCPSession()
        pieces = [whole[:20], whole[20:59], whole[59:]]
        starts = [1, 21, 60]
        found = [session.process(_segment(piece, seq)) for piece, seq in zip(pieces, starts, strict=True)]
        assert found[0] is None
        assert found[1][mqtt5.Publish].message == b"1" * 50
        assert found[2][mqtt5.Pingreq].payload == mqtt5.MQTT(bytes(mqtt5.Puback(packet_id=5)))
    finally:
        mqtt5.unbind()
    assert type(_segment(whole, 1)[TCP].payload) is Raw
