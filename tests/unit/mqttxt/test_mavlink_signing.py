"""Signing between UAV client and autopilot (docs/protocol.md, section 13), against pymavlink's own."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.address import BrokerAddress
from mqttxt.core.settings import Settings
from mqttxt.drone.journal import JournalFile
from mqttxt.drone.mavlink import signing as mavlink_signing
from mqttxt.drone.mavlink.frame_parser import Malformed
from mqttxt.drone.mavlink.signing import LINK_ID, Signing, read_key
from mqttxt.drone.mavlink.sources import Source
from mqttxt.drone.mavlink.stamps import EPOCH_S, LEAST_AHEAD, MOST, MOST_AHEAD, TICKS_PER_S, Stamps
from mqttxt.drone.mavlink.transports import AutopilotAddress
from mqttxt.drone.process import UavRunner
from mqttxt.errors import ConfigurationError
from tests.rigs.link_bench import LinkBench
from tests.rigs.processes import eventually
from tests.simulation.world import ack, heartbeat

KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))
NOW_S = 1_800_000_000.0
NOW = int((NOW_S - EPOCH_S) * TICKS_PER_S)
MINUTE = 60 * TICKS_PER_S


class Clock:
    """A system's clock that a test sets."""

    def __init__(self, now_s: float = NOW_S) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        return self.now_s


def signer(
    stamp: int = NOW, key: bytes | None = KEY, link_id: int = 0, system: int = 1, component: int = 1
) -> mavlink.MAVLink:
    """An autopilot's encoder, or another component's; pymavlink counts the stamps up by itself."""
    made = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    if key is not None:
        made.signing.secret_key, made.signing.link_id, made.signing.timestamp = key, link_id, stamp
        made.signing.sign_outgoing = True
    return made


def read(frame: bytes) -> Any:
    return mavlink.MAVLink(None).decode(bytearray(frame))


def beat(stamp: int = NOW, **more: Any) -> bytes:
    return bytes(heartbeat().pack(signer(stamp, **more)))


def stamp_of(frame: bytes) -> int:
    return int.from_bytes(frame[-12:-6], "little")


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def stamps(tmp_path: Path, clock: Clock) -> Stamps:
    return Stamps(tmp_path / "stamps", clock)


@pytest.fixture
def signing(stamps: Stamps) -> Signing:
    return Signing(KEY, stamps)


def heard(signing: Signing, frame: bytes, now_s: float = 0.0) -> str:
    """What becomes of a frame: its type, or under what it is refused."""
    found = signing.judge(read(frame), now_s)
    return str(found.kind) if isinstance(found, Malformed) else str(found.get_type())


# -- time stamps


def test_stamps_rise_whatever_the_clock_does(stamps: Stamps, clock: Clock) -> None:
    given = [stamps.next(), stamps.next()]
    clock.now_s -= 10_000.0
    given += [stamps.next(), stamps.next()]
    clock.now_s += 20_000.0
    given += [stamps.next()]
    assert given == [NOW, NOW + 1, NOW + 2, NOW + 3, NOW + 10_000 * TICKS_PER_S]


def test_stamps_never_go_back_over_restarts(tmp_path: Path) -> None:
    """Not even of a client that is killed at any moment, on a machine that starts in 1970 each time."""
    clock, last = Clock(NOW_S), 0
    for _ in range(50):
        stamps = Stamps(tmp_path / "stamps", clock)
        for _ in range(7):
            given = stamps.next()
            assert given is not None
            assert given > last
            last = given
            if stamps.is_due:
                stamps.keep()
            clock.now_s += 1.7
        clock.now_s = 0.0


@pytest.mark.long
def test_the_file_is_ahead_by_a_minute_at_most_and_not_more_with_each_restart(tmp_path: Path, clock: Clock) -> None:
    for _ in range(200):  # restarted every three seconds
        stamps = Stamps(tmp_path / "stamps", clock)
        for _ in range(3):
            stamps.next()
            if stamps.is_due:
                stamps.keep()
            clock.now_s += 1.0
    assert stamps.now() - int((clock.now_s - EPOCH_S) * TICKS_PER_S) <= 200 * LEAST_AHEAD
    stamps = Stamps(tmp_path / "stamps", clock)
    for _ in range(300):
        if stamps.is_due:
            stamps.keep()
        assert int((tmp_path / "stamps").read_text()) - stamps.now() <= MOST_AHEAD
        clock.now_s += 1.0


def test_what_the_others_time_is_ahead_counts(stamps: Stamps) -> None:
    stamps.adopt(NOW + 5000)
    stamps.adopt(3)
    assert stamps.next() == NOW + 5001


def test_the_last_stamp_there_is_comes_once(stamps: Stamps) -> None:
    stamps.adopt(MOST - 1)
    assert [stamps.next(), stamps.next(), stamps.now()] == [MOST, None, MOST]
    stamps.keep()
    assert not stamps.is_due


@pytest.mark.parametrize("text", ["", "yesterday", "-3", str(MOST + 1), "1.5", "9" * 40])
def test_a_file_that_has_no_stamp_is_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "stamps").write_text(text)
    with pytest.raises(ConfigurationError, match=r"stamps: .*; expected a MAVLink time stamp, or no such file"):
        Stamps(tmp_path / "stamps")


@pytest.mark.parametrize("spoilt", ["stamps", "stamps.copy"])
@pytest.mark.parametrize("content", [b"", bytes(16), b"\xff\xfe3"])
def test_of_the_file_and_its_copy_one_is_enough_for_any_clock(
    tmp_path: Path, clock: Clock, spoilt: str, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    before = Stamps(tmp_path / "stamps", clock)
    before.keep()
    clock.now_s += 1.0
    last = before.next()
    assert last is not None
    (tmp_path / spoilt).write_bytes(content)
    after = Stamps(tmp_path / "stamps", Clock(0.0))
    assert heard(Signing(KEY, after), beat(last - MINUTE - LEAST_AHEAD)) == "mavlink_old"
    assert (after.next() or 0) > last
    assert caplog.text.count("; its copy is used") == 1
    assert after.is_due
    after.keep()
    assert int((tmp_path / spoilt).read_bytes()) > last


def test_a_file_that_is_lost_is_found_in_its_copy(tmp_path: Path, clock: Clock) -> None:
    before = Stamps(tmp_path / "stamps", clock)
    before.keep()
    (tmp_path / "stamps").unlink()
    assert Stamps(tmp_path / "stamps", Clock(0.0)).now() >= before.now()


def test_without_a_stamp_in_the_file_or_its_copy_nothing_starts(tmp_path: Path, clock: Clock) -> None:
    """With a clock in 1970 it would hear all that was recorded."""
    Stamps(tmp_path / "stamps", clock).keep()
    for name in ("stamps", "stamps.copy"):
        (tmp_path / name).write_bytes(bytes(16))
    with pytest.raises(ConfigurationError, match=r"stamps: .*; expected a MAVLink time stamp, or no such file"):
        Stamps(tmp_path / "stamps", clock)


# -- keys


def key_file(folder: Path, text: str, mode: int = 0o600) -> Path:
    path = folder / "drone1.key"
    path.write_text(text)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("text", [KEY.hex(), KEY.hex() + "\n", KEY.hex().upper(), KEY.hex(" ")])
def test_a_key_is_64_hexadecimal_digits(tmp_path: Path, text: str) -> None:
    assert read_key(key_file(tmp_path, text)) == KEY


@pytest.mark.parametrize(
    ("text", "mode", "says"),
    [
        (KEY.hex(), 0o640, "mode 0640, so others can use the key; expected 0600"),
        (KEY.hex()[:-2], 0o600, "31 bytes; expected 64 hexadecimal digits"),
        (KEY.hex()[:-1], 0o600, "expected 64 hexadecimal digits"),
        ("", 0o600, "0 bytes; expected 64 hexadecimal digits"),
        ("correct horse battery staple", 0o600, "expected 64 hexadecimal digits"),
        ("é" * 64, 0o600, "expected 64 hexadecimal digits"),
        ("00" * 32, 0o600, "all zeros, which switches signing off"),
    ],
)
def test_a_wrong_key_file_is_one_line(tmp_path: Path, text: str, mode: int, says: str) -> None:
    with pytest.raises(ConfigurationError) as raised:
        read_key(key_file(tmp_path, text, mode))
    assert str(tmp_path / "drone1.key") in str(raised.value)
    assert says in str(raised.value)
    assert "\n" not in str(raised.value)
    assert KEY.hex()[:20] not in str(raised.value)


# -- what is heard


def test_what_pymavlink_signs_is_heard_in_its_order(signing: Signing) -> None:
    autopilot = signer()
    for _ in range(5):
        assert heard(signing, bytes(heartbeat().pack(autopilot))) == "HEARTBEAT"


def test_nothing_is_heard_without_the_key(signing: Signing) -> None:
    version_1 = bytes(heartbeat().pack(signer(key=None), force_mavlink1=True))
    changed = bytearray(beat())
    changed[-1] ^= 1
    assert [heard(signing, frame) for frame in (beat(key=None), version_1, beat(key=OTHER_KEY), bytes(changed))] == [
        "mavlink_unsigned",
        "mavlink_unsigned",
        "mavlink_other_key",
        "mavlink_other_key",
    ]
    radio = mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1).pack(signer(key=None))
    assert heard(signing, bytes(radio)) == "mavlink_unsigned"


def test_what_was_heard_is_not_heard_again(signing: Signing) -> None:
    first, second = beat(NOW), beat(NOW + 1)
    assert [heard(signing, frame) for frame in (second, second, first)] == ["HEARTBEAT", "mavlink_old", "mavlink_old"]


def test_a_stream_begins_a_minute_behind_at_the_most(signing: Signing) -> None:
    assert heard(signing, beat(NOW - MINUTE - 1)) == "mavlink_old"
    assert heard(signing, beat(NOW - MINUTE)) == "HEARTBEAT"


def test_a_forged_time_stamp_silences_nobody(signing: Signing) -> None:
    assert heard(signing, beat(MOST, key=OTHER_KEY)) == "mavlink_other_key"
    assert heard(signing, beat(NOW)) == "HEARTBEAT"


def test_what_was_signed_for_a_pilots_radio_is_not_heard_here(signing: Signing) -> None:
    """Its own link id has its own time stamps, so that what came there a moment ago is not old."""
    radio = [beat(NOW + each, link_id=1) for each in range(3)]
    assert heard(signing, beat(NOW + 10, link_id=0), 0.0) == "HEARTBEAT"
    assert heard(signing, radio[0], 3.0) == "mavlink_other_link"
    assert heard(signing, radio[1], 3.1) == "HEARTBEAT", "its own link is silent: it may be another now"
    assert heard(signing, beat(NOW + 11, link_id=0), 3.2) == "mavlink_other_link"


def test_components_have_streams_of_their_own(signing: Signing) -> None:
    for system, component in ((1, 1), (1, 154), (255, 190)):
        assert heard(signing, beat(NOW, system=system, component=component)) == "HEARTBEAT"


def test_an_autopilot_whose_clock_is_ahead_brings_the_client_with_it(signing: Signing, stamps: Stamps) -> None:
    assert heard(signing, beat(NOW + 1000 * MINUTE)) == "HEARTBEAT"
    assert stamps.next() == NOW + 1000 * MINUTE + 1


# -- the link


@pytest.fixture
async def bench(signing: Signing) -> AsyncIterator[LinkBench]:
    async with LinkBench(signing).open() as made:
        yield made


@pytest.fixture
async def unkeyed() -> AsyncIterator[LinkBench]:
    async with LinkBench().open() as made:
        yield made


async def test_pymavlink_accepts_what_the_link_writes_in_every_name(bench: LinkBench) -> None:
    autopilot = bench.socket()
    await bench.say(autopilot, beat())
    receiver = mavlink.MAVLink(None)
    receiver.signing.secret_key, receiver.signing.timestamp = KEY, NOW
    for source in (*Source, *Source):
        (frame,) = bench.write(ack(400), source)
        found: Any = receiver.decode(bytearray(frame))
        assert (found.get_signed(), found.get_link_id()) == (True, LINK_ID)


async def test_nobody_without_the_key_takes_the_link(bench: LinkBench) -> None:
    forger, autopilot = bench.socket(), bench.socket()
    for frame in (beat(key=None), beat(key=OTHER_KEY)):
        await bench.say(forger, frame)
        assert bench.write(heartbeat()) == [b"", b""]
    await bench.say(autopilot, beat())
    assert bench.heard == ["HEARTBEAT"]
    assert [bool(frame) for frame in bench.write(ack(400))] == [False, True]


async def test_an_autopilot_without_a_clock_hears_heartbeats_and_nothing_else(bench: LinkBench) -> None:
    autopilot = bench.socket()
    await bench.say(autopilot, beat(0))
    assert bench.refused == ["mavlink_old"]
    assert bench.write(ack(400)) == [b""]
    (frame,) = bench.write(heartbeat())
    await bench.say(autopilot, beat(stamp_of(frame) + 1))
    assert bench.heard == ["HEARTBEAT"]
    assert [bool(frame) for frame in bench.write(ack(400))] == [True]


async def test_an_autopilot_that_starts_anew_at_another_port_comes_back(
    bench: LinkBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = bench.socket()
    await bench.say(before, beat(NOW + MINUTE))
    monkeypatch.setattr("mqttxt.drone.mavlink.transports.HEARTBEAT_LOST_MS", 0)  # its heartbeats stay away
    monkeypatch.setattr(mavlink_signing, "HEARTBEAT_LOST_MS", 0)
    anew = bench.socket()
    await bench.say(anew, beat(7))
    assert bench.heard == ["HEARTBEAT"]
    assert [bool(frame) for frame in bench.write(ack(400))] == [True, False], "commands go nowhere else yet"
    _, frame = bench.write(heartbeat())
    await bench.say(anew, beat(stamp_of(frame) + 1, link_id=2))
    assert [bool(frame) for frame in bench.write(ack(400))] == [False, True]


async def test_a_played_back_heartbeat_takes_no_commands_away(bench: LinkBench) -> None:
    autopilot, forger = bench.socket(), bench.socket()
    recorded = beat(NOW)
    await bench.say(autopilot, recorded)
    await bench.say(forger, recorded)
    assert [bool(frame) for frame in bench.write(ack(400))] == [True, False]
    assert [bool(frame) for frame in bench.write(heartbeat())] == [True, False]


async def test_nothing_is_written_once_no_stamp_is_left(bench: LinkBench, stamps: Stamps) -> None:
    autopilot = bench.socket()
    await bench.say(autopilot, beat(MOST))
    assert bench.write(heartbeat()) == [b""]
    assert bench.refused == ["mavlink_no_stamps"]


async def test_without_a_key_a_signed_autopilot_is_heard_and_the_option_named(unkeyed: LinkBench) -> None:
    autopilot = unkeyed.socket()
    autopilot.send(beat())
    await eventually(lambda: unkeyed.heard == ["HEARTBEAT"], "heard")
    assert unkeyed.refused == ["mavlink_signed"]


# -- the client


async def test_a_full_disk_ends_no_signing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stamps rise all the same; the client says once that it cannot keep them, and keeps them when it can."""
    full = True
    written = Stamps.keep

    def keep(stamps: Stamps) -> None:
        if full:
            raise ConfigurationError(f"{tmp_path}: No space left on device; expected to be able to write it")
        written(stamps)

    monkeypatch.setattr(Stamps, "keep", keep)
    monkeypatch.setattr("mqttxt.drone.process.KEEP_EVERY_S", 0.01)
    journal = JournalFile(tmp_path / "drone1.journal")
    signing = Signing.load(key_file(tmp_path, KEY.hex()), tmp_path / "drone1.journal")
    runner = UavRunner(
        1,
        BrokerAddress.parse("mqtt://127.0.0.1:1"),
        AutopilotAddress("udp", "127.0.0.1", 0),
        journal,
        Settings(),
        signing=signing,
    )
    running = asyncio.create_task(runner.run())
    await eventually(lambda: runner.counts["mavlink_time"] > 2, "it was tried again and again")
    full = False
    await eventually(lambda: (tmp_path / "drone1.journal.mavlink-time").exists(), "they are kept")
    running.cancel()
    await asyncio.wait({running})
    journal.close()
    assert int((tmp_path / "drone1.journal.mavlink-time").read_text()) > signing.stamps.now()
    assert oct(os.stat(tmp_path / "drone1.key").st_mode & 0o777) == "0o600"
