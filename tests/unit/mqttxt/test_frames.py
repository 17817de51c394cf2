"""What a link's bytes say: no bytes swallow the frames behind them, and a datagram is a whole."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.mavlink.frame_parser import HELD_S, MOST_SPOILT, Malformed, StreamFrames, in_datagram
from tests.simulation.world import ack, heartbeat

AUTOPILOT = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
HEARTBEAT = heartbeat().pack(AUTOPILOT)
ACK = ack(400).pack(AUTOPILOT)
UNKNOWN = bytes([0xFD, 4, 0, 0, 7, 1, 1, 0xFE, 0xFF, 0x7F]) + bytes(6)
"""A frame of a dialect that common.xml does not know."""
NOISE = st.binary(max_size=40) | st.sampled_from([b"\xfd\xff", b"\xfe\xff", b"\xfd", UNKNOWN, HEARTBEAT[:-1]])


def kinds(found: Any) -> list[str]:
    return [message.get_type() for message in found if not isinstance(message, Malformed)]


def test_a_datagram_brings_all_of_its_frames() -> None:
    assert kinds(in_datagram(HEARTBEAT + UNKNOWN + ACK)) == ["HEARTBEAT", "COMMAND_ACK"]


@pytest.mark.parametrize("noise", [b"\xfd\xff", b"\xfe\xff", b"\x00", b"\xfd" * 9, HEARTBEAT[:-1]])
def test_what_is_no_frame_costs_no_datagram_but_its_own(noise: bytes) -> None:
    assert any(isinstance(found, Malformed) for found in in_datagram(noise))
    assert kinds(in_datagram(HEARTBEAT)) == ["HEARTBEAT"]
    assert kinds(in_datagram(noise + ACK)) == ["COMMAND_ACK"]


@pytest.mark.parametrize("noise", [b"\xfe\x00", b"\xfd\x00\x00", b"\xfd", b"\xfd\xff\x00"])
def test_a_datagram_of_noise_is_given_up_before_it_costs_much(noise: bytes) -> None:
    assert 0 < len(list(in_datagram(noise * (65_000 // len(noise))))) <= MOST_SPOILT


@given(st.lists(st.sampled_from([HEARTBEAT, ACK, UNKNOWN]), max_size=8), st.data())
def test_a_stream_that_is_cut_anywhere_brings_every_frame(frames: list[bytes], data: st.DataObject) -> None:
    stream, heard = StreamFrames(), []
    rest = b"".join(frames)
    while rest:
        cut = data.draw(st.integers(1, len(rest)))
        heard += kinds(stream.feed(rest[:cut], 0.0))
        rest = rest[cut:]
    assert heard == kinds(found for frame in frames for found in in_datagram(frame))


@given(NOISE, st.integers(1, 30))
def test_noise_on_a_line_hides_no_heartbeat_longer_than_a_frame_is_waited_for(noise: bytes, length: int) -> None:
    stream = StreamFrames()
    heard = kinds(stream.feed(noise, 0.0))
    heard += [kind for beat in range(1, length + 2) for kind in kinds(stream.feed(HEARTBEAT, beat * (HELD_S + 0.01)))]
    assert heard.count("HEARTBEAT") >= length


def test_what_is_in_a_frame_is_not_a_frame() -> None:
    """A tunnel's payload may look like one: it is not taken out of the frame that carries it."""
    payload = [*ACK, *[1] * (128 - len(ACK))]
    tunnel = mavlink.MAVLink_tunnel_message(1, 1, 0, len(ACK), payload).pack(AUTOPILOT)
    stream = StreamFrames()
    assert kinds(stream.feed(tunnel[:60], 0.0)) == []
    assert kinds(stream.feed(tunnel[60:], 0.0)) == ["TUNNEL"]


def test_nobody_can_make_a_stream_keep_more_than_a_frame() -> None:
    stream = StreamFrames()
    for _ in range(100):
        list(stream.feed(b"\xfd\xff" * 500, 0.0))
    assert len(stream) < 2 * 280
