"""Frames out of captures: layers that add up, MQTT packets found, cuts said."""

from __future__ import annotations

from pathlib import Path

import pytest
from attempts import T0, frame, publish, write_pcap
from hypothesis import given
from hypothesis import strategies as st
from scapy.layers.inet import ICMP, IP, UDP
from scapy.layers.inet6 import IPv6
from scapy.layers.l2 import ARP, Ether
from scapy.packet import Raw

from testbed.capture import CaptureNotes, dissect, mqtt_packets, read_frames
from testbed.errors import ResultsError


def test_layers_of_a_publish_add_up_to_the_frame() -> None:
    data = frame("gs", "cloud", publish("a/b", b"12345"), 1)
    found = dissect(T0, data, len(data), {})
    # 2 fixed header + 2 length + 3 topic + 1 properties = 8 of MQTT, 5 of payload
    assert found.layers == {"ethernet": 14, "ip": 20, "tcp": 20, "mqtt": 8, "payload": 5}
    assert sum(found.layers.values()) == found.size == 67
    assert (found.source, found.destination, found.protocol) == ("198.18.0.3", "198.18.1.3", "mqtt")
    assert [(p.topic, p.payload, p.header_bytes) for p in found.publishes] == [("a/b", b"12345", 8)]


def test_a_padded_acknowledgement_counts_its_padding_as_ethernet() -> None:
    data = frame("gs", "cloud", b"", 1).ljust(60, b"\0")
    found = dissect(T0, data, len(data), {})
    assert found.layers == {"ethernet": 20, "ip": 20, "tcp": 20, "mqtt": 0, "payload": 0}


def test_several_packets_in_a_segment_are_all_found() -> None:
    body = publish("a", b"1") + b"\xc0\x00" + publish("b", b"22", qos=1) + b"\x40\x02\x00\x07"
    kinds, publishes = mqtt_packets(body, {})
    assert kinds == ("publish", "pingreq", "publish", "puback")
    assert [p.payload for p in publishes] == [b"1", b"22"]


def test_a_publish_cut_over_two_segments_is_named_but_not_read() -> None:
    kinds, publishes = mqtt_packets(publish("a", b"1" * 50)[:20], {})
    assert kinds == ("publish",)
    assert publishes == ()


@given(st.binary(max_size=80))
def test_no_segment_raises(body: bytes) -> None:
    kinds, publishes = mqtt_packets(body, {})
    assert len(publishes) <= len(kinds)


@pytest.mark.parametrize(
    ("packet", "protocol"),
    [
        (Ether() / ARP(), "arp"),
        (Ether() / IPv6(), "ipv6"),
        (Ether() / IP(src="1.2.3.4", dst="5.6.7.8") / ICMP(), "icmp"),
        (Ether() / IP(src="1.2.3.4", dst="5.6.7.8") / UDP() / Raw(b"123"), "udp"),
    ],
)
def test_other_frames_are_told_apart_and_counted_whole(packet: Ether, protocol: str) -> None:
    data = bytes(packet)
    found = dissect(T0, data, len(data), {})
    assert found.protocol == protocol
    assert sum(found.layers.values()) == len(data)


def test_time_stamps_are_nanoseconds(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    write_pcap(path, [(T0 + 123_456_789, frame("gs", "cloud", b"", 1))])
    assert [f.t_ns for f in read_frames(path)] == [T0 + 123_456_789]


def test_a_truncated_capture_is_read_up_to_the_cut_and_it_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    write_pcap(path, [(T0, frame("gs", "cloud", b"", n)) for n in range(3)])
    path.write_bytes(path.read_bytes()[:-10])
    notes = CaptureNotes()
    assert len(list(read_frames(path, notes))) == 2
    assert notes.truncated
    write_pcap(path, [(T0, frame("gs", "cloud", b"", 1))])
    notes = CaptureNotes()
    assert len(list(read_frames(path, notes))) == 1
    assert not notes.truncated


def test_an_empty_capture_is_one_that_was_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.touch()
    notes = CaptureNotes()
    assert list(read_frames(path, notes)) == []
    assert notes.truncated


@given(st.binary(max_size=120), st.sampled_from([b"\x45", b"\x4f", b"\x40"]), st.sampled_from([1, 6, 17, 89]))
def test_no_frame_raises(noise: bytes, version: bytes, protocol: int) -> None:
    data = bytes(12) + b"\x08\x00" + version + noise[:8] + bytes([protocol]) + noise[8:]
    assert dissect(T0, data, len(data), {}).size == len(data)


def test_what_is_no_capture_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(b"not a capture")
    with pytest.raises(ResultsError, match=r"a\.pcap: not a capture"):
        list(read_frames(path))


THERE = (50_000, 1883)


def aliased(topic: str, alias: int, payload: bytes) -> bytes:
    """A QoS 0 PUBLISH with a topic alias behind a payload format indicator and a user property."""
    properties = b"\x01\x00" + b"\x26\x00\x01k\x00\x01v" + b"\x23" + alias.to_bytes(2, "big")
    rest = len(topic).to_bytes(2, "big") + topic.encode() + bytes([len(properties)]) + properties + payload
    return b"\x30" + bytes([len(rest)]) + rest


def test_a_topic_alias_is_read_as_the_topic_that_it_stands_for_until_the_connection_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    syn = bytearray(frame("gs", "cloud", b"", 4, THERE))
    syn[14 + 20 + 13] |= 0x02
    frames = [
        frame("gs", "cloud", aliased("a/b", 1, b"1") + aliased("", 1, b"2"), 1, THERE),
        frame("gs", "cloud", aliased("", 1, b"3"), 2, THERE),
        frame("cloud", "gs", aliased("", 1, b"4"), 3, THERE[::-1]),
        bytes(syn),
        frame("gs", "cloud", aliased("", 1, b"5"), 5, THERE),
    ]
    write_pcap(path, [(T0 + number, data) for number, data in enumerate(frames)])
    found = [(p.topic, p.payload) for f in read_frames(path) for p in f.publishes]
    assert found == [("a/b", b"1"), ("a/b", b"2"), ("a/b", b"3"), ("", b"4"), ("", b"5")]
