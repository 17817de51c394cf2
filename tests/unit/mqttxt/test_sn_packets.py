"""MQTT-SN on the wire: packets to bytes and back, predefined topic ids, and messages together (section 20)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.contrib.mqttsn import MQTTSN

from mqttxt.core.mqtt.sn import packets
from mqttxt.core.mqtt.sn.codec import decode, encode
from mqttxt.core.mqtt.sn.packets import NORMAL, PREDEFINED, Packet
from mqttxt.core.mqtt.sn.together import AirMessage, Unpacker, pack
from mqttxt.core.mqtt.sn.topic_ids import TOGETHER, TopicIds, Travel
from mqttxt.protocol.commands import COMMANDS
from mqttxt.protocol.names import MAX_DRONE
from mqttxt.protocol.states import STATES
from mqttxt.protocol.topics import FogSide
from tests.examples import examples

U16 = st.integers(0, 0xFFFF)
MSG_ID = st.integers(1, 0xFFFF)
CODE = st.integers(0, 0xFF)
TEXT = st.text(min_size=1, max_size=80)
TOPIC = st.one_of(TEXT, U16)
BOOLS = st.booleans()
PAYLOAD = st.binary(max_size=400)


@st.composite
def messages(draw: st.DrawFn) -> packets.Message:
    qos = draw(st.integers(0, 1))
    return packets.Message(
        draw(U16),
        draw(PAYLOAD),
        draw(st.sampled_from((NORMAL, PREDEFINED))),
        qos,
        draw(MSG_ID) if qos else 0,
        draw(BOOLS),
        draw(BOOLS),
    )


PACKETS: st.SearchStrategy[Packet] = st.one_of(
    st.builds(packets.Connect, TEXT, U16, BOOLS, BOOLS),
    st.builds(packets.Connack, CODE),
    st.just(packets.WillTopicReq()),
    st.builds(packets.WillTopic, TEXT, st.integers(0, 1), BOOLS),
    st.just(packets.WillMsgReq()),
    st.builds(packets.WillMsg, PAYLOAD),
    st.builds(packets.Register, U16, U16, TEXT),
    st.builds(packets.Regack, U16, U16, CODE),
    messages(),
    st.builds(packets.Puback, U16, U16, CODE),
    st.builds(packets.Subscribe, U16, TOPIC, st.integers(0, 1), BOOLS, BOOLS),
    st.builds(packets.Suback, U16, U16, CODE, st.integers(0, 1)),
    st.builds(packets.Unsubscribe, U16, TOPIC),
    st.builds(packets.Unsuback, U16),
    st.just(packets.Pingreq()),
    st.just(packets.Pingresp()),
    st.builds(packets.Disconnect, st.one_of(st.none(), U16)),
)


@pytest.mark.parametrize(
    ("hexadecimal", "packet"),
    [
        ("0d 04 0c 01 00 0f 64 72 6f 6e 65 31 61", packets.Connect("drone1a", 15, has_will=True)),
        ("03 05 00", packets.Connack(0)),
        ("02 06", packets.WillTopicReq()),
        ("05 07 30 61 62", packets.WillTopic("ab")),
        ("05 09 01 02 03", packets.WillMsg(b"\1\2\3")),
        ("08 0a 00 00 00 07 61 62", packets.Register(0, 7, "ab")),
        ("07 0b 00 01 00 07 00", packets.Regack(1, 7)),
        ("09 0c 01 03 01 00 00 18 40", packets.Message(0x0301, b"\x18\x40")),
        ("08 0c b1 03 80 00 09 00", packets.Message(0x0380, b"\0", qos=1, msg_id=9, retain=True, dup=True)),
        ("07 0d 03 80 00 09 10", packets.Puback(0x0380, 9, 0x10)),
        ("07 12 31 00 02 03 86", packets.Subscribe(2, 0x0386, live_only=True)),
        ("08 13 20 03 86 00 02 00", packets.Suback(0x0386, 2)),
        ("07 14 01 00 03 03 86", packets.Unsubscribe(3, 0x0386)),
        ("04 15 00 03", packets.Unsuback(3)),
        ("02 16", packets.Pingreq()),
        ("02 17", packets.Pingresp()),
        ("02 18", packets.Disconnect()),
        ("04 18 00 01", packets.Disconnect(1)),
    ],
)
def test_the_bytes_are_those_of_the_standard(hexadecimal: str, packet: Packet) -> None:
    """Byte by byte from MQTT-SN 1.2, section 5.4."""
    assert encode(packet) == bytes.fromhex(hexadecimal)
    assert decode(bytes.fromhex(hexadecimal)) == packet


def test_a_length_of_more_than_a_byte_takes_three() -> None:
    assert encode(packets.WillMsg(bytes(253)))[:3] == bytes((0xFF, 0x09, 0))
    datagram = encode(packets.WillMsg(bytes(254)))
    assert datagram[:4] == bytes((0x01, 0x01, 0x02, 0x09))
    assert len(datagram) == 0x0102
    with pytest.raises(ValueError, match="65540 bytes; expected at most 65535"):
        encode(packets.WillMsg(bytes(65_536)))


@pytest.mark.parametrize(
    ("datagram", "wrong"),
    [
        ("", "0 bytes; expected a length and a kind"),
        ("02", "1 bytes"),
        ("01 00 04", "3 bytes"),
        ("03 16", "length 3 of a datagram of 2 bytes"),
        ("02 03", "packet kind 0x03: not spoken here"),
        ("03 17 00", "1 bytes behind the kind 0x17: expected none"),
        ("08 04 00 02 00 0f 61 62", "protocol 2: expected 1"),
        ("06 04 00 01 00 0f", "client id: expected at least one character"),
        ("08 0c 41 03 01 00 09 00", "QoS 2: expected 0 or 1"),
        ("08 0c 61 03 01 00 00 00", "QoS -1: expected 0 or 1"),
        ("08 0c 02 61 62 00 00 00", "topic id type 2: expected 0 or 1"),
        ("08 0c 01 03 01 00 09 00", "message id 9 at QoS 0"),
        ("08 0c 21 03 01 00 00 00", "message id 0 at QoS 1"),
        ("06 12 00 00 02 ff", "packet kind 0x12: 'utf-8'"),
        ("04 0d 00 01", "packet kind 0x0d: unpack requires"),
    ],
)
def test_what_is_no_packet_is_refused_with_the_reason(datagram: str, wrong: str) -> None:
    with pytest.raises(ValueError, match=wrong):
        decode(bytes.fromhex(datagram))


@given(st.one_of(st.binary(max_size=80), PACKETS.map(encode).flatmap(lambda data: st.permutations(data).map(bytes))))
@examples(500)
def test_no_datagram_does_anything_but_be_read_or_be_refused(datagram: bytes) -> None:
    try:
        packet = decode(datagram)
    except ValueError:
        return
    assert decode(encode(packet)) == packet


ROOTS = st.sampled_from(("", "fog1/local/", "acme/fog12/local/"))


def fixed_topics(root: str, drone: int) -> list[str]:
    """Every topic of a drone that has no open name in it."""
    side = FogSide(root)
    plain = (
        *(side.reachable, side.clock, side.init_connect, side.states, side.sensor_ack, side.stations, side.control),
        *(side.bulk, side.bulk_answer, side.commands),
    )
    named = [side.state(drone, name) for name in STATES]
    named += [side.commands_result(drone, name) for name in (*COMMANDS, "malformed")]
    return [side.revoked, *(topic(drone) for topic in plain), *named]


@given(ROOTS, st.integers(1, MAX_DRONE))
@examples(50)
def test_each_fixed_topic_has_an_id_that_no_other_one_has(root: str, drone: int) -> None:
    ids, topics = TopicIds(root), fixed_topics(root, drone)
    found = [ids.id_of(topic) for topic in topics]
    assert None not in found
    assert TOGETHER not in found
    assert len(set(found)) == len(topics)
    assert [ids.topic_of(each) for each in found if each is not None] == topics


@given(st.integers(0, 0xFFFF))
@examples(300)
def test_an_id_is_a_topic_s_or_nobody_s(topic_id: int) -> None:
    topic = TopicIds().topic_of(topic_id)
    assert topic is None or TopicIds().id_of(topic) == topic_id


def test_ids_stay_as_they_are() -> None:
    """A UAV client and a gateway of two versions have to agree."""
    known = {
        "drone1/state/battery": 0x0101,
        "drone1/state/location": 0x0102,
        "drone1/state/text": 0x0110,
        "drone1/state/fence": 0x0112,
        "drone1/commands_result/malformed": 0x0140,
        "drone1/commands_result/arm": 0x0141,
        "drone1/commands_result/set_parameter": 0x0151,
        "drone250/reachable": 0xFA80,
        "drone250/clock": 0xFA81,
        "drone250/init_connect": 0xFA82,
        "drone250/commands": 0xFA86,
        "drone250/sensor_ack": 0xFA89,
        "fleet/revoked": 2,
    }
    assert {topic: TopicIds().id_of(topic) for topic in known} == known
    without = ("drone1/state/mavlink/VFR_HUD", "drone1/sensor3/light", "drone251/clock", "fog1/clock", "drone1/nothing")
    assert [TopicIds().id_of(topic) for topic in without] == [None] * len(without)


def test_how_a_topic_travels() -> None:
    ids = TopicIds()
    assert ids.travel("drone1/state/location") is Travel.NEWEST
    assert ids.travel("drone1/state/mavlink/VFR_HUD") is Travel.NEWEST
    assert ids.travel("drone1/bulk_answer") is Travel.ONCE
    for name in ("state/text", "states", "clock", "commands", "reachable", "commands_result/arm", "sensor3/light"):
        assert ids.travel(f"drone1/{name}") is Travel.SURELY, name


def test_a_client_says_and_hears_what_a_uav_client_does() -> None:
    ids = TopicIds()
    said = ("reachable", "clock", "state/battery", "states", "commands_result/arm", "bulk_answer", "sensor3/light")
    heard = ("reachable", "init_connect", "stations", "control", "commands", "bulk", "sensor_ack")
    everything = {*said, *heard}
    assert {name for name in everything if ids.may_say(1, f"drone1/{name}")} == set(said)
    assert {name for name in everything if ids.may_hear(1, f"drone1/{name}")} == set(heard)
    assert ids.may_say(1, "fleet/revoked")
    assert ids.may_hear(1, "fleet/revoked")
    for topic in ("drone2/reachable", "drone2/commands", "#", "+/commands", "drone1/#", "fog1/commands"):
        assert not ids.may_say(1, topic)
        assert not ids.may_hear(1, topic)


TOLD = st.builds(
    AirMessage,
    st.sampled_from(("drone1/clock", "drone1/sensor3/light", "fleet/revoked", "drone1/state/mavlink/VFR_HUD")),
    st.binary(max_size=300),
    st.integers(0, 1),
    st.booleans(),
)


@given(st.lists(TOLD, max_size=8), st.integers(1, 200))
@examples(200)
def test_messages_together_come_back_however_they_are_cut(told: list[AirMessage], cut: int) -> None:
    ids, stream = TopicIds(), b"".join(pack(each, TopicIds()) for each in told)
    unpacker = Unpacker(ids)
    found = [each for at in range(0, len(stream), cut) for each in unpacker.take(stream[at : at + cut])]
    assert found == told


@given(st.lists(st.binary(max_size=60), max_size=6))
@examples(300)
def test_a_stream_of_anything_is_read_or_refused(pieces: list[bytes]) -> None:
    unpacker = Unpacker(TopicIds())
    try:
        for piece in pieces:
            for told in unpacker.take(piece):
                assert told.topic
    except ValueError:
        pass


@given(PACKETS)
@examples(300)
def test_a_packet_comes_back_from_its_bytes_and_a_foreign_codec_reads_the_same(packet: Packet) -> None:
    """scapy's, which was written by others."""
    datagram = encode(packet)
    assert decode(datagram) == packet
    read = MQTTSN(datagram)
    assert (read.type, read.len) == (packet.KIND, len(datagram))
    assert bytes(read) == datagram
    inside = read.payload
    if isinstance(packet, packets.Message):
        assert (inside.tid, inside.mid, bytes(inside.data)) == (packet.topic_id, packet.msg_id, packet.payload)
        assert (inside.qos, inside.dup, inside.retain) == (packet.qos, packet.dup, packet.retain)
        assert inside.tid_type == packet.id_type
    elif isinstance(packet, packets.Connect):
        assert (inside.client_id.decode(), inside.duration) == (packet.client_id, packet.duration_s)
        assert (inside.will, inside.cleansess) == (packet.has_will, packet.is_clean)
    elif isinstance(packet, packets.Puback | packets.Regack | packets.Suback):
        assert (inside.tid, inside.mid, inside.return_code) == (packet.topic_id, packet.msg_id, packet.code)
