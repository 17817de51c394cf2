"""The stand-in's signing: MAVLink's C library is what it follows, and what each kind takes unsigned."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mavlink

from sitl.errors import SitlError
from sitl.personalities import PERSONALITIES
from sitl.signing import MOST_STREAMS, OLDEST_START, Codec, Signing, read_key

KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))


def signer(stamp: int, key: bytes | None = KEY, link_id: int = 7, component: int = 191) -> mavlink.MAVLink:
    made = mavlink.MAVLink(None, srcSystem=1, srcComponent=component)
    if key is not None:
        made.signing.secret_key, made.signing.timestamp, made.signing.link_id = key, stamp, link_id
        made.signing.sign_outgoing = True
    return made


def command(stamp: int = 0, **more: Any) -> bytes:
    return bytes(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(signer(stamp, **more)))


def taken(codec: Codec, frame: bytes) -> bool:
    return [message.get_type() for message in codec.parse_buffer(frame) or ()] == ["COMMAND_LONG"]


def keyed(key: bytes | None = KEY, like: str = "px4") -> Signing:
    return Signing(1, PERSONALITIES[like].unsigned, key)


def test_without_a_key_everything_is_taken() -> None:
    codec = keyed(None).codec()
    assert [taken(codec, frame) for frame in (command(key=None), command(5), command(5, key=OTHER_KEY))] == [True] * 3


def test_with_a_key_nothing_else_is_taken() -> None:
    codec = keyed().codec()
    frames = (command(key=None), command(5, key=OTHER_KEY), command(5), command(5), command(4), command(6))
    assert [taken(codec, frame) for frame in frames] == [False, False, True, False, False, True]


@pytest.mark.parametrize(("like", "heartbeat"), [("px4", "HEARTBEAT"), ("ardupilot", "BAD_DATA")])
def test_what_each_kind_takes_unsigned(like: str, heartbeat: str) -> None:
    codec, pilot = keyed(like=like).codec(), signer(0, key=None)
    radio = mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1).pack(pilot)
    beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(pilot)
    assert [message.get_type() for message in codec.parse_buffer(radio) or ()] == ["RADIO_STATUS"]
    assert [message.get_type() for message in codec.parse_buffer(beat) or ()] == [heartbeat]


def test_a_forged_time_stamp_changes_nothing() -> None:
    codec = keyed().codec()
    assert not taken(codec, command(2**48 - 1, key=OTHER_KEY))
    assert taken(codec, command(5))


def test_links_share_streams_and_number_themselves() -> None:
    signing = keyed()
    first, second = signing.codec(), signing.codec()
    assert taken(first, command(5))
    assert not taken(second, command(5)), "played back at another link"
    sent = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(second)
    assert sent[-13] == 1


def test_its_time_is_that_of_the_latest_it_heard() -> None:
    codec = keyed().codec()
    assert taken(codec, command(OLDEST_START + 10))
    assert not taken(codec, command(9, component=192))
    assert taken(codec, command(10, component=192))
    beat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(codec)
    assert int.from_bytes(beat[-12:-6], "little") == OLDEST_START + 10


def test_a_seventeenth_stream_is_not_heard() -> None:
    codec = keyed().codec()
    assert [taken(codec, command(5, link_id=each)) for each in range(MOST_STREAMS + 1)] == [True] * 16 + [False]


def test_a_key_is_set_up_and_taken_away() -> None:
    signing = keyed(None)
    codec = signing.codec()
    signing.set_up(mavlink.MAVLink_setup_signing_message(1, 1, list(KEY), 1000))
    assert [taken(codec, frame) for frame in (command(key=None), command(5))] == [False, True]
    signing.set_up(mavlink.MAVLink_setup_signing_message(1, 1, [0] * 32, 0))
    assert taken(codec, command(key=None))


@pytest.mark.parametrize(
    ("text", "says"), [("00", "1 bytes; expected 32"), ("words", "expected 64 hexadecimal digits")]
)
def test_a_wrong_key_file_is_one_line(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "key").write_text(text)
    with pytest.raises(SitlError, match=says):
        read_key(tmp_path / "key")
    with pytest.raises(SitlError, match="No such file"):
        read_key(tmp_path / "none")
