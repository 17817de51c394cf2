"""What tcpdump is asked, and what it says when it ends."""

from __future__ import annotations

import json
from pathlib import Path

from net.captures import Counts, capture_command, parse_counts, write_counts
from net.interfaces import Cable, Port

PORT = Port("uav1", Cable("198.18.21.2", "198.18.21.3"), "eth4", "02:42:c6:12:15:02")


def test_frames_are_whole_with_nanoseconds_and_handed_over_at_once(tmp_path: Path) -> None:
    command = capture_command(PORT, tmp_path)
    assert {"--time-stamp-precision=nano", "--immediate-mode", "--packet-buffered"} <= set(command)
    assert command[command.index("-s") + 1] == "0"
    assert command[-4:] == ["-i", "eth4", "-w", str(tmp_path / "uav1.pcap")]


def test_counts_are_read_from_the_last_words() -> None:
    said = "listening on eth4\n1 packet captured\n12 packets received by filter\n3 packets dropped by kernel\n"
    assert parse_counts(PORT, said) == Counts("uav1", "eth4", PORT.mac, captured=1, received=12, dropped=3)


def test_what_a_killed_capture_did_not_say_is_unknown() -> None:
    assert parse_counts(PORT, "listening on eth4\n") == Counts("uav1", "eth4", PORT.mac, None, None, None)


def test_counts_are_written_whole(tmp_path: Path) -> None:
    write_counts([Counts("uav1", "eth4", PORT.mac, 1, 1, 0)], tmp_path / "captures.json")
    assert [path.name for path in tmp_path.iterdir()] == ["captures.json"]
    assert json.loads((tmp_path / "captures.json").read_text()) == [
        {"node": "uav1", "interface": "eth4", "mac": PORT.mac, "captured": 1, "received": 1, "dropped": 0}
    ]
