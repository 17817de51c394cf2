"""The packets table of captures whose answers were counted by hand."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common
from scapy.layers.inet import ICMP, IP, UDP
from scapy.layers.inet6 import IPv6
from scapy.layers.l2 import ARP, Ether
from scapy.packet import Raw

from sitl.unnamed import Unnamed
from testbed.errors import ResultsError
from testbed.fly.pcap import PADDING, read_capture
from testbed.fly.results import Attempt, Series, new_series
from testbed.numbers.packets import Packets, load
from testbed.numbers.packets.links import match
from testbed.numbers.packets.mavlink import find_messages
from testbed.numbers.packets.purposes import of_messages
from tests.examples import examples
from tests.handmade.attempts import SECOND, T0, frame, make_attempt, publish, write_only, write_pcap
from tests.handmade.mavlink_attempts import (
    HOP,
    MS,
    Chain,
    fill_streams,
    long_command,
    make_mavlink_attempt,
    packed,
    sender,
    udp_frame,
)
from tests.handmade.packets_tables import rows

HEARTBEAT = common.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3)


def table_of(series: Series, chain: Chain, mac: bool = True) -> Packets:
    return load(make_mavlink_attempt(series, 1, chain, [], 1.0, mac))


def test_a_message_is_seen_on_each_link_of_its_way(series: Series) -> None:
    chain = Chain()
    chain.send(T0, packed(sender(1), HEARTBEAT), 1, up=True)
    found = table_of(series, chain)
    assert rows(found.frames, "link", "t_ns", "left_ns", "source", "destination", "flow", "node") == [
        ("air:uav1:up", T0, T0 + HOP // 2, "uav1", "fog1", "uav1:14541>fog1:14541", "uav1"),
        ("backhaul:fog1:up", T0 + HOP, T0 + HOP + HOP // 2, "fog1", "cloud", "fog1:14541>cloud:14541", "fog1"),
        ("wan:gs:down", T0 + 2 * HOP, T0 + 2 * HOP + HOP // 2, "cloud", "gs", "cloud:14541>gs:14541", "cloud"),
    ]
    # 10 bytes of header and 2 of CRC around a payload of 9
    sizes = ("size", "ethernet", "ip", "transport", "protocol_bytes", "payload", "protocol", "messages", "kind")
    assert rows(found.frames, *sizes) == [(63, 14, 20, 8, 12, 9, "mavlink", 1, "HEARTBEAT")] * 3
    own = ("frame", "kind", "bytes", "copies", "version", "system", "component", "sequence", "topic")
    assert rows(found.messages, *own) == [(row, "HEARTBEAT", 21, 1, 2, 1, 1, 0, None) for row in range(3)]
    assert found.messages["crc"].n_unique() == 1
    assert (found.truncated, found.foreign, found.unmatched) == ((), {}, 0)


def test_what_is_forwarded_keeps_its_addresses_and_still_crosses_each_link(series: Series) -> None:
    chain = Chain(direct=True)
    chain.send(T0, packed(sender(1), HEARTBEAT), 1, up=True)
    chain.send(T0 + SECOND, packed(sender(245, 190), HEARTBEAT), 1, up=False)
    found = table_of(series, chain)
    up = [(link, "uav1", "gs") for link in ("air:uav1:up", "backhaul:fog1:up", "wan:gs:down")]
    down = [(link, "gs", "uav1") for link in ("wan:gs:up", "backhaul:fog1:down", "air:uav1:down")]
    assert rows(found.frames, "link", "source", "destination") == up + down
    assert found.frames["left_ns"].null_count() == 0  # although the TTL and the header's checksum differ at each hop


def test_without_the_networks_own_addresses_neighbours_are_told_by_theirs(series: Series) -> None:
    chain = Chain()
    chain.send(T0, packed(sender(1), HEARTBEAT), 1, up=True)
    assert table_of(series, chain, mac=False).frames["link"].to_list() == [
        *("air:uav1:up", "backhaul:fog1:up", "wan:gs:down")
    ]


def test_a_frame_that_a_link_lost_never_left_it(series: Series) -> None:
    chain, link = Chain(), sender(1)
    chain.send(T0, packed(link, HEARTBEAT), 1, up=True, lost_on="cloud")
    chain.send(T0 + SECOND, packed(link, HEARTBEAT), 1, up=True)
    found = table_of(series, chain)
    assert found.frames.filter(pl.col("left_ns").is_null())["link"].to_list() == ["backhaul:fog1:up"]
    assert found.messages.filter(pl.col("left_ns").is_null())["sequence"].to_list() == [0]


def test_all_messages_of_a_datagram_are_found_and_signatures_and_version_1_too(series: Series) -> None:
    link = sender(1)
    first, second = packed(link, HEARTBEAT), packed(link, HEARTBEAT, version_1=True)
    signed = bytearray(packed(link, HEARTBEAT)) + b"s" * 13
    signed[2] = 1
    chain = Chain()
    chain.send(T0, first + bytes(signed) + second, 1, up=True, until="fog1")
    found = table_of(series, chain)
    assert rows(found.frames, "size", "protocol_bytes", "payload", "messages") == [(42 + 21 + 34 + 17, 45, 27, 3)]
    assert rows(found.messages, "frame", "version", "sequence", "bytes") == [
        (0, 2, 0, 21),
        (0, 2, 2, 34),
        (0, 1, 1, 17),
    ]


def test_a_frame_at_the_very_end_is_not_lost_because_captures_do_not_end_at_once(series: Series) -> None:
    chain, link = Chain(), sender(1)
    for at, lost_on in ((0, None), (500 * MS, "gs"), (1000 * MS, None), (1040 * MS, "gs"), (1080 * MS, "cloud")):
        chain.send(T0 + at, packed(link, HEARTBEAT), 1, up=True, lost_on=lost_on)
    frames = table_of(series, chain).frames.filter(pl.col("link") == "wan:gs:down")
    assert frames["lost"].to_list() == [False, True, False, False]
    assert frames["left_ns"].is_null().to_list() == [False, True, False, True]


def test_commands_are_read_although_mavlink_2_cuts_their_zeros_off(series: Series) -> None:
    chain, link = Chain(), sender(245, 190)
    goto = common.MAVLink_command_int_message(1, 1, 6, 192, 0, 0, -1.0, 1.0, 0.0, 0.0, 473977000, 85455000, 500.0)
    ack = common.MAVLink_command_ack_message(400, 0, 0, 0, 245, 190)
    for number, message in enumerate((long_command(400, 1, 1.0), long_command(176, 1, 1.0, 4.0, 5.0), goto, ack)):
        chain.send(T0 + number, packed(link, message), 1, up=False, until="cloud")
    found = table_of(series, chain)
    assert rows(found.messages, "kind", "target_system", "command", "param1", "param2", "param3") == [
        ("COMMAND_LONG", 1, 400, 1.0, 0.0, 0.0),
        ("COMMAND_LONG", 1, 176, 1.0, 4.0, 5.0),
        ("COMMAND_INT", 1, 192, -1.0, 1.0, 0.0),
        ("COMMAND_ACK", 245, 400, None, None, None),
    ]


def test_every_field_agrees_with_pymavlinks_own_parser(series: Series) -> None:
    chain = Chain()
    every = {known.msgname: 1.0 for known in common.mavlink_map.values()}
    count = fill_streams(chain, 1.0, every)
    found = table_of(series, chain).messages.filter(pl.col("link") == "air:uav1:up")
    parser = common.MAVLink(None)
    datagrams = [data[42:] for t_ns, data in chain.captures["uav1"]]
    parsed = [message for data in datagrams for message in parser.parse_buffer(data)]
    assert len(parsed) == count == len(every)
    expected = [
        (
            *(m.get_type(), m.get_srcSystem(), m.get_srcComponent(), m.get_seq(), m.get_crc(), len(m.get_msgbuf())),
            getattr(m, "target_system", None),
        )
        for m in parsed
    ]
    names = ("kind", "system", "component", "sequence", "crc", "bytes", "target_system")
    assert rows(found, *names) == expected


@pytest.mark.parametrize(
    ("name", "fields", "purpose"),
    [
        ("LINK_NODE_STATUS", 11, "upkeep"),
        ("TIME_ESTIMATE_TO_TARGET", 5, "state"),
        ("CURRENT_EVENT_SEQUENCE", 2, "state"),
    ],
)
def test_what_pymavlink_leaves_out_of_common_xml_has_its_name(
    series: Series, name: str, fields: int, purpose: str
) -> None:
    chain = Chain()
    chain.send(T0, Unnamed(name, (1,) * fields).pack(sender(1)), 1, up=True)
    found = table_of(series, chain).messages
    assert rows(found, "kind") == [(name,)] * 3
    assert of_messages(found, [1]).to_list() == [purpose] * 3


@pytest.mark.parametrize(
    ("name", "from_drone", "from_station"),
    [
        ("MISSION_ITEM_INT", "result", "command"),
        ("MISSION_ACK", "result", "command"),
        ("LOG_DATA", "result", "command"),
        ("FILE_TRANSFER_PROTOCOL", "result", "command"),
        ("MISSION_CURRENT", "state", "state"),
        ("MISSION_ITEM_REACHED", "state", "state"),
    ],
)
def test_what_carries_a_mission_or_a_log_is_of_the_command_and_its_result(
    name: str, from_drone: str, from_station: str
) -> None:
    told = {"kind": [name] * 2, "protocol": ["mavlink"] * 2, "system": [1, 245], "command": [None] * 2}
    found = pl.DataFrame(told | {"topic": [None] * 2}, schema_overrides={"command": pl.Int64, "topic": pl.String})
    assert of_messages(found, [1]).to_list() == [from_drone, from_station]


def test_a_datagram_that_is_no_mavlink_is_udp(series: Series) -> None:
    chain = Chain()
    for number, body in enumerate((b"", b"\xfd", b"\xfd\x09" + bytes(10), b"hello, world")):
        chain.send(T0 + number, body, 1, up=True, until="fog1")
    found = table_of(series, chain)
    sizes = ("protocol", "size", "protocol_bytes", "payload", "messages", "kind")
    assert rows(found.frames, *sizes) == [("udp", 42 + n, 0, n, 0, None) for n in (0, 1, 12, 12)]


def test_aliases_segments_and_connections_are_those_of_one_direction(series: Series) -> None:
    attempt = make_attempt(series)
    data = publish("a/b", b"12345", qos=1)
    frames = [
        (T0, frame("gs", "cloud", data[:7], 1, sequence=100)),
        (T0 + MS, frame("gs", "cloud", data[7:], 2, sequence=107)),
        (T0 + 2 * MS, frame("cloud", "gs", b"\x40\x02\x00\x01", 3, (1883, 40_000))),
    ]
    write_only(attempt, gs=frames[:2], cloud=[(t + MS // 2, data) for t, data in frames])
    found = load(attempt)
    assert rows(found.frames, "link", "protocol_bytes", "payload", "messages", "kind") == [
        ("wan:gs:up", 7, 0, 1, "publish"),
        ("wan:gs:up", 3, 5, 0, None),
        ("wan:gs:down", 4, 0, 1, "puback"),
    ]
    assert rows(found.messages, "frame", "left_ns", "kind", "topic", "body", "bytes", "system") == [
        (0, T0 + MS + MS // 2, "publish", "a/b", b"12345", 15, None),
        (2, None, "puback", None, None, 4, None),
    ]


def test_a_padded_acknowledgement_counts_its_padding_as_ethernet(series: Series) -> None:
    attempt = make_attempt(series)
    for node in ("gs", "cloud"):
        write_pcap(attempt.path / "pcap" / f"{node}.pcap", [(T0, frame("gs", "cloud", b"", 1).ljust(60, b"\0"))])
    found = load(attempt).frames.filter(pl.col("link") == "wan:gs:up")
    assert rows(found, "size", "ethernet", "ip", "transport", "payload", "messages") == [(60, 20, 20, 20, 0, 0)]


@pytest.mark.parametrize(
    ("packet", "protocol"),
    [
        (Ether() / ARP(), "arp"),
        (Ether() / IPv6(), "ipv6"),
        (Ether() / IP(src="1.2.3.4", dst="5.6.7.8") / ICMP(), "icmp"),
        (Ether() / IP(src="1.2.3.4", dst="5.6.7.8") / UDP() / Raw(b"123"), "udp"),
        (Ether() / IP(src="1.2.3.4", dst="5.6.7.8", frag=9, proto=17) / Raw(b"123"), "other"),
        (Ether(type=0x88CC) / Raw(b"123"), "other"),
    ],
)
def test_frames_on_no_link_are_counted_apart(series: Series, packet: Ether, protocol: str) -> None:
    attempt = make_attempt(series)
    write_pcap(attempt.path / "pcap" / "gs.pcap", [(T0, bytes(packet))])
    found = load(attempt)
    assert found.foreign == {protocol: 1}
    assert rows(found.strays, "t_ns", "node", "protocol", "size") == [(T0, "gs", protocol, len(bytes(packet)))]
    assert "wan:gs:up" not in found.frames["link"].to_list()


def test_other_frames_between_neighbours_are_on_their_link(series: Series) -> None:
    attempt = make_attempt(series)
    ping = bytes(Ether() / IP(src="198.18.0.3", dst="198.18.1.3") / ICMP() / Raw(b"123"))
    write_pcap(attempt.path / "pcap" / "gs.pcap", [(T0, ping)])
    found = load(attempt).frames.filter(pl.col("link") == "wan:gs:up")
    assert rows(found, "protocol", "size", "payload", "flow") == [("icmp", 45, 11, "gs>cloud")]


def test_a_capture_is_read_up_to_its_cut_and_named(series: Series) -> None:
    attempt = make_attempt(series)
    whole = load(attempt)
    assert whole.truncated == ()
    path = attempt.path / "pcap" / "uav1.pcap"
    path.write_bytes(path.read_bytes()[:-10])
    cut = load(attempt)
    assert cut.truncated == ("uav1.pcap",)
    assert len(cut.frames) == len(whole.frames) - 1
    path.write_bytes(b"")
    assert load(attempt).truncated == ("uav1.pcap",)
    path.write_bytes(b"\x4d\x3c\xb2\xa1\x02")
    assert load(attempt).truncated == ("uav1.pcap",)


def test_an_address_that_is_none_is_said(series: Series) -> None:
    attempt = make_attempt(series)
    (attempt.path / "pcap" / "captures.json").write_text('[{"node": "gs", "dropped": 0, "mac": "02:42:c6"}]')
    with pytest.raises(ResultsError, match=r"captures\.json: mac of gs is 02:42:c6, expected six bytes"):
        load(attempt)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"not a capture", r"uav1\.pcap: not a capture: it begins with b'not '"),
        (
            b"\x4d\x3c\xb2\xa1" + bytes(16) + b"\x71\x00\x00\x00",
            r"uav1\.pcap: link type is 113, expected 1 \(Ethernet\)",
        ),
    ],
)
def test_what_is_no_capture_is_said(series: Series, data: bytes, said: str) -> None:
    attempt = make_attempt(series)
    (attempt.path / "pcap" / "uav1.pcap").write_bytes(data)
    with pytest.raises(ResultsError, match=said):
        load(attempt)


def test_microseconds_and_the_other_byte_order_are_read_too(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    head = b"\xa1\xb2\xc3\xd4" + bytes(16) + b"\0\0\0\1"
    path.write_bytes(head + b"".join(number.to_bytes(4, "big") for number in (7, 5, 3, 60)) + b"abc")
    found = read_capture(path)
    assert (found.t_ns.tolist(), found.lengths.tolist(), found.sizes.tolist()) == ([7_000_005_000], [3], [60])
    assert bytes(found.data[found.starts[0] :][:3]) == b"abc"


def test_the_cache_gives_the_same_and_is_made_again_when_a_capture_or_the_version_changes(
    series: Series, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempt = make_attempt(series)
    first = load(attempt)
    made = (attempt.path / "packets.parquet").stat().st_mtime_ns
    again = load(attempt)
    assert again.frames.equals(first.frames)
    assert again.messages.equals(first.messages)
    assert (again.truncated, again.foreign, again.unmatched) == (first.truncated, first.foreign, first.unmatched)
    assert again.strays.equals(first.strays)
    assert (attempt.path / "packets.parquet").stat().st_mtime_ns == made
    os.utime(attempt.path / "pcap" / "gs.pcap", ns=(T0 * 2, T0 * 2))
    load(attempt)
    remade = (attempt.path / "packets.parquet").stat().st_mtime_ns
    assert remade != made
    monkeypatch.setattr("testbed.numbers.packets.table.VERSION", 0)
    load(attempt)
    assert (attempt.path / "packets.parquet").stat().st_mtime_ns != remade


@pytest.mark.parametrize("name", ["packets.parquet", "messages.parquet"])
def test_a_cache_that_is_damaged_or_half_there_is_made_again(series: Series, name: str) -> None:
    attempt = make_attempt(series)
    first = load(attempt)
    path = attempt.path / name
    path.write_bytes(path.read_bytes()[:-20])
    assert load(attempt).frames.equals(first.frames)
    path.unlink()
    assert load(attempt).messages.equals(first.messages)
    assert not list(attempt.path.glob(".*.new"))


def test_an_attempt_without_captures_has_an_empty_table(series: Series) -> None:
    attempt = make_attempt(series)
    for path in (attempt.path / "pcap").iterdir():
        path.unlink()
    found = load(attempt)
    assert (len(found.frames), len(found.messages), found.foreign, found.truncated) == (0, 0, {}, ())


@pytest.mark.parametrize(
    ("entered", "left", "expected"),
    [
        ([10, 20], [15, 25], [0, 1]),
        ([10, 11], [15, 16], [0, 1]),  # slower than they follow each other: the n-th is the n-th
        ([10, 20, 30], [25, 35], [-1, 0, 1]),  # the first was lost
        ([10, 20, 30], [15, 35], [0, -1, 1]),
        ([10, 20, 30, 31], [35, 36, 37], [-1, 0, 1, 2]),  # one was lost, three are on the link at once
        ([20, 30], [15], [-1, -1]),
        ([10, 20], [], [-1, -1]),
        ([20], [15, 25], [1]),  # one that was not seen entering
    ],
)
def test_equal_frames_are_matched_in_the_order_of_time(
    entered: list[int], left: list[int], expected: list[int]
) -> None:
    def keys(times: list[int]) -> Any:
        return np.full(len(times), 7, dtype=np.uint64)

    found = match(keys(entered), np.array(entered), keys(left), np.array(left, dtype=np.int64))
    assert found.tolist() == expected


@given(st.binary(max_size=120), st.integers(0, 60))
def test_no_bytes_make_the_message_parser_raise(noise: bytes, at: int) -> None:
    data = np.frombuffer(noise + bytes(PADDING), dtype=np.uint8)
    found = find_messages(data, np.array([min(at, len(noise))]), np.array([len(noise)]))
    assert found.size.sum() <= len(noise)


_MAGIC = st.sampled_from([b"", b"\xfd", b"\xfe", publish("a", b"1")])
_KNOWN = st.builds(
    lambda protocol, noise, magic, ihl: bytes(12) + b"\x08\x00" + bytes([ihl]) + bytes(8) + bytes([protocol]) + bytes(2)
    + bytes([198, 18, 0, 3, 198, 18, 1, 3]) + b"\x9c\x40\x07\x5b" + noise + magic + noise,
    st.sampled_from([1, 6, 17, 89]), st.binary(max_size=60), _MAGIC, st.sampled_from([0x45, 0x4F, 0x40]),
)  # fmt: skip


@pytest.mark.long
@examples(60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.binary(max_size=100) | _KNOWN, max_size=4), st.integers(0, 80))
def test_no_capture_makes_the_table_raise(tmp_path: Path, frames: list[bytes], cut: int) -> None:
    attempt = Attempt(tmp_path, "mqttxt", 1)
    if not (tmp_path / "pcap").exists():
        made = make_attempt(new_series(tmp_path / "results", "scenario-1", "thesis", "ideal"))
        made.path.joinpath("manifest.json").rename(tmp_path / "manifest.json")
        (tmp_path / "pcap").mkdir()
    for node in ("gs", "cloud"):
        write_pcap(tmp_path / "pcap" / f"{node}.pcap", [(T0 + n, data) for n, data in enumerate(frames)])
    path = tmp_path / "pcap" / "gs.pcap"
    path.write_bytes(path.read_bytes()[: max(24, path.stat().st_size - cut)])
    found = load(replace(attempt))
    layers = found.frames.select(pl.sum_horizontal("ethernet", "ip", "transport", "protocol_bytes", "payload"))
    assert len(layers) == len(found.frames)
    assert sum(found.foreign.values()) + len(found.frames) <= 2 * len(frames)
    assert (found.frames["protocol_bytes"] >= 0).all()
    assert (found.frames["payload"] >= 0).all()


def test_udp_frames_of_the_generator_are_what_scapy_makes() -> None:
    made = Ether(udp_frame("198.18.0.3", "198.18.1.3", b"abc", 5))
    assert (made[IP].src, made[IP].dst, made[IP].id, made[IP].ttl) == ("198.18.0.3", "198.18.1.3", 5, 64)
    assert (made[UDP].sport, made[UDP].len, bytes(made[UDP].payload)) == (14541, 11, b"abc")
