"""MQTT packets in TCP streams: found where they begin, whole although segments cut, repeat and swap them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from testbed.numbers.packets.mqtt import Segment, read_direction
from testbed.numbers.packets.streams import runs
from tests.handmade.attempts import publish
from tests.handmade.packets_tables import stream


def again(segments: list[Segment], row: int, left_ns: int | None) -> Segment:
    """A retransmission of a segment, in another frame."""
    return Segment(left_ns or 99, left_ns, segments[row].sequence, False, segments[row].body)


def published(segments: list[Segment]) -> list[tuple[str | None, bytes | None]]:
    return [(p.topic, p.payload) for p in read_direction(segments).packets if p.kind == "publish"]


def aliased(topic: str, alias: int, payload: bytes) -> bytes:
    """A QoS 0 PUBLISH with a topic alias behind a payload format indicator and a user property."""
    properties = b"\x01\x00" + b"\x26\x00\x01k\x00\x01v" + b"\x23" + alias.to_bytes(2, "big")
    rest = len(topic).to_bytes(2, "big") + topic.encode() + bytes([len(properties)]) + properties + payload
    return b"\x30" + bytes([len(rest)]) + rest


def connect(version: int) -> bytes:
    rest = b"\x00\x04MQTT" + bytes([version]) + b"\x02\x00\x3c" + b"\x00" * 2
    return b"\x10" + bytes([len(rest)]) + rest


def test_several_packets_in_a_segment_are_all_found() -> None:
    body = publish("a", b"1") + b"\xc0\x00" + publish("b", b"22", qos=1) + b"\x40\x02\x00\x07"
    found = read_direction(stream(body))
    assert [(p.kind, p.size) for p in found.packets] == [("publish", 7), ("pingreq", 2), ("publish", 10), ("puback", 4)]
    assert [p.payload for p in found.packets] == [b"1", None, b"22", None]
    assert found.payload_bytes == {0: 3}


def test_a_publish_over_three_segments_begins_in_the_first_and_has_left_with_the_last() -> None:
    data = publish("a/b", b"0123456789")  # 8 bytes of MQTT, then the payload
    found = read_direction(stream(data[:5], data[5:12], data[12:]))
    (packet,) = found.packets
    assert (packet.row, packet.left_ns, packet.payload, packet.size) == (0, 2, b"0123456789", 18)
    assert found.payload_bytes == {0: 0, 1: 4, 2: 6}


def test_segments_are_put_in_the_order_of_their_sequence_numbers_even_where_these_wrap() -> None:
    data = publish("a", b"1" * 20) + publish("b", b"2")
    one, two, three = stream(data[:10], data[10:20], data[20:], first=2**32 - 15)
    assert published([one, three, two]) == [("a", b"1" * 20), ("b", b"2")]


def test_a_retransmission_is_no_second_message_and_what_follows_waits_for_it_where_the_first_was_lost() -> None:
    """TCP hands on in order: a later message that is there already has not arrived."""
    segments = stream(publish("a", b"1"), publish("b", b"2"))
    lost = Segment(0, None, segments[0].sequence, False, segments[0].body)
    found = read_direction([lost, segments[1], again(segments, 0, 7)])
    assert [(p.topic, p.left_ns, p.copies) for p in found.packets] == [("a", 7, 2), ("b", 7, 1)]
    assert found.payload_bytes == {0: 1, 1: 1, 7: 1}
    assert [p.left_ns for p in read_direction([lost, segments[1]]).packets] == [None, 1]


def test_a_retransmission_that_cuts_otherwise_gives_only_what_is_new() -> None:
    data = publish("a", b"1" * 8) + publish("b", b"2" * 8)
    early, late = stream(data[:6], data[6:])
    longer = Segment(5, 5, early.sequence, False, data[:20])
    assert published([early, longer, late]) == [("a", b"1" * 8), ("b", b"2" * 8)]


def test_a_message_begins_in_the_first_frame_that_had_it_not_in_a_repetition_that_begins_before_it() -> None:
    first, second = stream(publish("a", b"1"), publish("b", b"2"))
    together = Segment(5, 5, first.sequence, False, first.body + second.body)
    found = read_direction([first, second, together])
    assert [(p.topic, p.row, p.left_ns, p.copies) for p in found.packets] == [("a", 0, 0, 2), ("b", 1, 1, 2)]


def test_a_message_whose_parts_arrived_has_arrived_though_its_repetition_as_a_whole_was_lost() -> None:
    data = publish("b", b"2" * 20)
    before, early, late = stream(publish("a", b"1"), data[:8], data[8:])
    together = Segment(5, None, before.sequence, False, before.body + data)
    found = read_direction([before, early, late, together])
    assert [(p.topic, p.row, p.left_ns) for p in found.packets] == [("a", 0, 0), ("b", 1, 2)]


@given(st.lists(st.tuples(st.integers(0, 20), st.integers(1, 12), st.none() | st.integers(0, 9)), max_size=8))
def test_who_carried_a_byte_and_when_it_had_arrived_is_that_of_a_plain_count(
    parts: list[tuple[int, int, int | None]],
) -> None:
    sent = [(0, 4, 0), *parts]
    segments = [Segment(row, left, 1000 + at, False, b"x" * size) for row, (at, size, left) in enumerate(sent)]
    for run in runs(segments):
        carriers = {
            place: [segment for segment in segments if 0 <= place - (segment.sequence - 1000) < len(segment.body)]
            for place in range(run.origin, run.reached)
        }
        for place, own in carriers.items():
            assert (run.row_of(place), run.copies_of(place)) == (min(one.row for one in own), len(own))
            times = [[one.left_ns for one in carriers[at] if one.left_ns is not None] for at in carriers]
            came = all(times[place - run.origin :])
            assert run.left_ns(place, run.reached) == (max(min(each) for each in times if each) if came else None)


def test_after_a_gap_reading_goes_on_at_the_next_segment() -> None:
    whole = publish("a", b"1" * 50)
    one, _, three = stream(whole[:20], whole[20:], publish("b", b"2"))
    found = read_direction([one, three])
    assert [(p.kind, p.topic, p.size) for p in found.packets] == [("publish", None, None), ("publish", "b", 7)]


def test_what_is_no_mqtt_is_passed_over_up_to_the_next_segment() -> None:
    assert published(stream(b"\x00\x01\x02", b"\x30\xff\xff\xff\xff\xff", publish("b", b"2"))) == [("b", b"2")]


def test_a_topic_alias_is_read_as_the_topic_that_it_stands_for_until_the_connection_ends() -> None:
    segments = stream(aliased("a/b", 1, b"1") + aliased("", 1, b"2"), aliased("", 1, b"3"))
    opening = Segment(2, 2, 70_000, True, b"")
    after = Segment(3, 3, 70_001, False, aliased("", 1, b"4"))
    assert published([*segments, opening, after]) == [("a/b", b"1"), ("a/b", b"2"), ("a/b", b"3"), ("", b"4")]


def test_a_client_of_version_3_1_1_has_no_properties_in_its_publishes() -> None:
    data = b"\x30\x06\x00\x01a" + b"\x00xy"  # the payload begins with what would be empty properties
    assert published(stream(data)) == [("a", b"xy")]
    old = read_direction(stream(connect(4), data))
    assert (old.packets[1].payload, old.version) == (b"\x00xy", 4)
    assert read_direction(stream(data), version=4).packets[0].payload == b"\x00xy"


@given(
    st.lists(
        st.builds(
            Segment,
            row=st.integers(0, 5),
            left_ns=st.none() | st.integers(0, 9),
            sequence=st.integers(0, 60) | st.integers(0, 2**32 - 1),
            syn=st.booleans(),
            body=st.binary(max_size=40)
            | st.sampled_from([publish("a/b", b"12"), aliased("a", 1, b""), connect(4), b"\x30\x05\x00"]),
        ),
        max_size=6,
    )
)
def test_no_bytes_in_no_order_raise(segments: list[Segment]) -> None:
    found = read_direction(segments)
    assert all(0 <= count <= 40 for count in found.payload_bytes.values())
    assert all(packet.copies >= 1 for packet in found.packets)


@given(
    st.lists(st.tuples(st.sampled_from(["a", "b/c"]), st.binary(max_size=30)), min_size=1, max_size=6),
    st.lists(st.integers(1, 12), min_size=1),
    st.randoms(use_true_random=False),
)
def test_however_a_stream_is_cut_and_shuffled_the_same_messages_are_read(sent, cuts, random) -> None:  # type: ignore[no-untyped-def]
    data = b"".join(publish(topic, payload) for topic, payload in sent)
    pieces, at = [], 0
    while at < len(data):
        size = cuts[len(pieces) % len(cuts)]
        pieces.append(data[at : at + size])
        at += size
    segments = stream(*pieces)
    rest = [*segments[1:], again(segments, 0, None)]
    random.shuffle(rest)
    assert published([segments[0], *rest]) == list(sent)
