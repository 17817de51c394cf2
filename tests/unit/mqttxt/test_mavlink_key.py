"""`mqttxt keys mavlink`: a key's file, and what cannot be brought into an autopilot."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
import typer

from mqttxt.drone.mavlink.signing import read_key
from tests.unit.mqttxt.typed import refused, typed

MAVLINK = ("keys", "mavlink")
WORDS = "every good boy deserves fruit"


def test_a_key_is_made_that_only_its_owner_can_read(tmp_path: Path) -> None:
    first, second = tmp_path / "one.key", tmp_path / "two.key"
    for path in (first, second):
        assert typed(*MAVLINK, path).exit_code == 0
        assert path.stat().st_mode & 0o777 == 0o600
    assert read_key(first) != read_key(second)
    before = first.read_bytes()
    assert "one.key: exists; expected another name" in refused(*MAVLINK, first)
    assert first.read_bytes() == before


def test_a_passphrase_makes_the_key_that_mavproxy_makes_of_it(tmp_path: Path) -> None:
    path = tmp_path / "one.key"
    done = typed(*MAVLINK, path, "--passphrase", said=f"{WORDS}\n{WORDS}\n")
    assert done.exit_code == 0, done.output
    assert WORDS not in done.output
    assert read_key(path) == hashlib.sha256(WORDS.encode()).digest()
    done = typed(*MAVLINK, tmp_path / "two.key", "--passphrase", said="short\nshort\n")
    assert (done.exit_code, (tmp_path / "two.key").exists()) == (2, False)
    assert "passphrase: 5 characters; expected 16 or more" in done.output


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--drone", "1"], "expected --install beside them"),
        (
            ["--install", "serial:/dev/ttyACM0:57600"],
            "--install: expected --drone, the autopilot's MAVLink system id, beside it",
        ),
        (
            ["--install", "serial:/dev/ttyACM0:57600", "--drone", "0"],
            "--drone 0: expected a whole number from 1 to 250",
        ),
        (["--install", "udp:0.0.0.0:14550", "--drone", "1"], "the key would cross a network in the clear"),
        (["--install", "tcp:10.0.0.1:5760", "--drone", "1"], "the key would cross a network in the clear"),
        (["--install", "usb", "--drone", "1"], "expected udp:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"),
        (["--install", "tcp:127.0.0.1:5760", "--drone", "1", "--old", "none.key"], "none.key: No such file"),
    ],
)
def test_what_cannot_be_installed_is_one_line_and_makes_no_key(tmp_path: Path, words: list[str], says: str) -> None:
    assert says in refused(*MAVLINK, tmp_path / "one.key", *words)
    assert not (tmp_path / "one.key").exists()


def test_a_passphrase_that_is_not_utf8_is_one_line(tmp_path: Path) -> None:
    words = "\udcff" * 20  # how Python reads such bytes from a terminal
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer, "prompt", lambda *_arguments, **_options: words)
        assert refused(*MAVLINK, tmp_path / "one.key", "--passphrase") == (
            "passphrase: not UTF-8; expected text in UTF-8"
        )
    assert not (tmp_path / "one.key").exists()
