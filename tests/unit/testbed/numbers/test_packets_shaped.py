"""The packets table of shaped links: what is lost, doubled, swapped, damaged, under way, or repeated by TCP."""

from __future__ import annotations

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from testbed.fly.results import Series
from testbed.numbers.packets import Packets, load
from testbed.numbers.packets.mqtt import Segment
from testbed.numbers.packets.purposes import of_topic
from testbed.numbers.packets.tcp import retransmissions
from tests.handmade.attempts import SECOND, T0, frame, make_attempt, publish, write_only, write_pcap
from tests.handmade.mavlink_attempts import HOP, MS, Chain, make_mavlink_attempt, packed, sender
from tests.handmade.packets_tables import rows

HEARTBEAT = common.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3)


def one_link(series: Series, entered: list[tuple[int, bytes]], left: list[tuple[int, bytes]]) -> Packets:
    """The table of what entered wan:gs:up at gs and what left it at the cloud; the mission ends ten seconds later."""
    attempt = make_attempt(series)
    write_only(attempt, gs=entered, cloud=left)
    return load(attempt)


def test_the_first_copy_counts_and_further_ones_are_no_frames_of_their_own(series: Series) -> None:
    sent = frame("gs", "cloud", publish("a", b"1"), 1)
    found = one_link(series, [(T0, sent)], [(T0 + 5 * MS, sent), (T0 + 7 * MS, sent)])
    assert rows(found.frames, "left_ns", "lost") == [(T0 + 5 * MS, False)]
    assert (found.unmatched, found.duplicates) == (1, 1)


def test_frames_that_overtake_each_other_keep_their_own_times(series: Series) -> None:
    first, second = (frame("gs", "cloud", publish("a", body), n, sequence=7 * n) for n, body in enumerate((b"1", b"2")))
    found = one_link(series, [(T0, first), (T0 + MS, second)], [(T0 + 4 * MS, second), (T0 + 9 * MS, first)])
    assert found.frames["left_ns"].to_list() == [T0 + 9 * MS, T0 + 4 * MS]
    assert found.unmatched == 0


@pytest.mark.parametrize("place", [14 + 20 + 20 + 3, 14 + 20 + 20 + 40, 14 + 20 + 4, 14 + 12])
def test_a_frame_of_which_a_bit_was_turned_did_not_leave_its_link(series: Series, place: int) -> None:
    sent = frame("gs", "cloud", publish("a/b", b"x" * 60), 1)
    damaged = bytearray(sent)
    damaged[place] ^= 0x10  # in the body's beginning, in its middle, in TCP's sequence number, in the source address
    found = one_link(series, [(T0, sent)], [(T0 + MS, bytes(damaged))])
    assert rows(found.frames, "left_ns", "lost") == [(None, True)]
    assert found.messages["left_ns"].to_list() == [None]
    assert found.duplicates == 0


def test_what_is_still_under_way_when_the_captures_end_is_not_lost(series: Series) -> None:
    attempt = make_attempt(series)
    frames = [frame("gs", "cloud", publish("a", b"1"), n, sequence=6 * n) for n in range(3)]
    end = T0 + 20 * SECOND  # after the mission's last event
    entered = [(T0, frames[0]), (T0 + SECOND, frames[1]), (end - SECOND // 10, frames[2])]
    write_pcap(attempt.path / "pcap" / "gs.pcap", entered)
    write_pcap(attempt.path / "pcap" / "cloud.pcap", [(T0 + SECOND // 5, frames[0])])
    write_pcap(attempt.path / "pcap" / "fog1.pcap", [(end, frame("fog1", "uav1", b"", 9, (1883, 6)))])
    write_pcap(attempt.path / "pcap" / "uav1.pcap", [(end, frame("fog1", "uav1", b"", 9, (1883, 6)))])
    found = load(attempt).frames.filter(pl.col("link") == "wan:gs:up")
    assert rows(found, "left_ns", "lost") == [(T0 + SECOND // 5, False), (None, True), (None, False)]


def test_nothing_is_said_to_be_lost_behind_the_cut_of_the_capture_that_should_have_it(series: Series) -> None:
    attempt = make_attempt(series)
    frames = [frame("gs", "cloud", publish("a", b"1"), n, sequence=6 * n) for n in range(3)]
    write_pcap(attempt.path / "pcap" / "gs.pcap", [(T0 + n * SECOND, data) for n, data in enumerate(frames)])
    cloud = attempt.path / "pcap" / "cloud.pcap"
    write_pcap(cloud, [(T0 + SECOND + MS, frames[1]), (T0 + 2 * SECOND + MS, frames[2])])
    cloud.write_bytes(cloud.read_bytes()[:-1])
    found = load(attempt)
    mine = found.frames.filter(pl.col("link") == "wan:gs:up")
    assert rows(mine, "left_ns", "lost") == [(None, True), (T0 + SECOND + MS, False), (None, False)]
    assert found.truncated == ("cloud.pcap",)
    assert found.until_ns["cloud"] == T0 + SECOND + MS


def test_a_retransmission_is_needed_or_needless_by_what_left_the_link(series: Series) -> None:
    bodies = [publish("a", b"1"), publish("a", b"2"), publish("a", b"3")]  # 7 bytes each
    first, second, third = (frame("gs", "cloud", body, n, sequence=7 * n) for n, body in enumerate(bodies))
    again = [frame("gs", "cloud", bodies[n], 10 + n, sequence=7 * n) for n in (1, 2)]
    sent = [first, second, third, *again]
    entered = [(T0 + n * MS, data) for n, data in enumerate(sent)]
    found = one_link(series, entered, [(t + 10 * MS, data) for t, data in entered if data != second])
    assert found.frames["repeats"].to_list() == [None, None, None, "needed", "needless"]
    assert found.frames["purpose"].to_list() == ["other"] * 5  # the topic is none of the protocol's
    assert rows(found.messages, "frame", "left_ns", "copies") == [
        (0, T0 + 10 * MS, 1),
        (1, T0 + 13 * MS, 2),
        (2, T0 + 13 * MS, 2),  # TCP hands it on behind the second
    ]


def test_a_frame_in_the_middle_of_a_message_is_for_what_the_message_is_for(series: Series) -> None:
    data = publish("fog1/drone1/state/battery", b"x" * 60)
    parts = [
        frame("gs", "cloud", part, n, sequence=at) for n, (at, part) in enumerate(((0, data[:50]), (50, data[50:])))
    ]
    bare = frame("gs", "cloud", b"", 3, sequence=len(data))
    found = one_link(series, [(T0 + n, part) for n, part in enumerate([*parts, bare])], [])
    assert found.frames["purpose"].to_list() == ["state", "state", "acknowledgement"]


def test_messages_are_for_what_their_protocols_say(series: Series) -> None:
    chain, drone, station, router = Chain(), sender(1), sender(245, 190), sender(231)
    up = [
        HEARTBEAT,
        common.MAVLink_command_ack_message(400, 0),
        common.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0),
        common.MAVLink_timesync_message(1, 1),
        common.MAVLink_command_long_message(0, 0, 205, 0, 1, 0, 0, 0, 0, 0, 0),  # PX4's own, to whom it may concern
    ]
    for number, message in enumerate(up):
        chain.send(T0 + number * MS, packed(drone, message), 1, up=True, until="fog1")
    chain.send(T0 + 10 * MS, packed(router, HEARTBEAT), 1, up=True, until="fog1")
    for number, command in enumerate((400, 511, 512)):
        body = packed(station, common.MAVLink_command_long_message(1, 1, command, 0, 1, 0, 0, 0, 0, 0, 0))
        chain.send(T0 + (20 + number) * MS, body, 1, up=False, until="cloud")
    found = load(make_mavlink_attempt(series, 1, chain, [], 1.0))
    assert found.messages["purpose"].to_list() == [
        *("state", "result", "state", "upkeep", "state", "upkeep"),
        *("command", "upkeep", "upkeep"),
    ]
    assert found.frames["purpose"].to_list() == found.messages["purpose"].to_list()


@pytest.mark.parametrize(
    ("topic", "purpose"),
    [
        ("fog1/commands", "command"),
        ("fog1/drone2/commands", "command"),
        ("fog1/commands/goto", "command"),
        ("fog1/drone2/commands_result/arm", "result"),
        ("fog1/commands_result/arm", "result"),
        ("drone2/state/battery", "state"),
        ("fog1/drone2/state/mavlink/ATTITUDE", "state"),
        ("fog1/states", "state"),
        ("fog1/reachable", "presence"),
        ("gs/g1/reachable", "presence"),
        ("fog1/PSMI", "presence"),
        ("fog1/QoDS", "presence"),
        ("fog1/clock", "upkeep"),
        ("drone2/init_connect", "upkeep"),
        ("drone2/sensor3/temperature", "sensor"),
        ("drone2/sensor_ack", "acknowledgement"),
        ("fog1/drone2/bulk", "command"),
        ("drone2/bulk_answer", "result"),
        ("someone/elses", "other"),
        ("", "other"),
        (None, "other"),
    ],
)
def test_the_purpose_of_a_topic(topic: str | None, purpose: str) -> None:
    assert of_topic(topic) == purpose


def segment(row: int, place: int, body: bytes, arrives: bool = True, syn: bool = False) -> Segment:
    return Segment(row, HOP if arrives else None, (2**32 - 20 + place) % 2**32, syn, body)


def test_a_repeated_opening_is_a_retransmission_and_a_new_connection_is_none() -> None:
    first = [segment(0, 0, b"", arrives=False, syn=True), segment(1, 0, b"", syn=True), segment(2, 1, b"x" * 30)]
    later = [segment(3, 900, b"", syn=True), segment(4, 901, b"y")]
    assert retransmissions(first + later) == {1: "needed"}


def test_a_repetition_that_is_cut_otherwise_is_needless_only_if_all_of_it_had_arrived() -> None:
    sent = [segment(0, 0, b"x" * 10), segment(1, 10, b"x" * 10, arrives=False), segment(2, 20, b"x" * 10)]
    assert retransmissions([*sent, segment(3, 0, b"x" * 30), segment(4, 5, b"x" * 25)]) == {3: "needed", 4: "needless"}


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 12), st.booleans(), st.booleans()), max_size=12))
def test_repetitions_are_those_of_a_plain_count_of_bytes(parts: list[tuple[int, int, bool, bool]]) -> None:
    segments = [segment(n, place, b"x" * size, arrives) for n, (place, size, arrives, _) in enumerate(parts)]
    expected: dict[int, str] = {}
    arrived: set[int] = set()
    sent = -1
    for number, (place, size, arrives, _) in enumerate(parts):
        span = range(place, place + size)
        if size and place <= sent:
            again = range(place, min(place + size, sent + 1))
            expected[number] = "needless" if set(again) <= arrived else "needed"
        sent = max([sent, *span])
        arrived |= set(span) if arrives else set()
    assert retransmissions(segments) == expected
