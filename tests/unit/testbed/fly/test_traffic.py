"""What each link carries, counted in captures while they are written."""

from __future__ import annotations

import struct
from ipaddress import IPv4Address
from pathlib import Path

import pytest

from testbed.errors import ResultsError
from testbed.fly.pcap import CaptureTail
from testbed.fly.traffic import Carried, Traffic
from testbed.plan.fleets import standard_fleet
from tests.handmade.attempts import write_pcap

FLEET = standard_fleet()
NET, NODE = b"\2\0\0\0\0\1", b"\2\0\0\0\0\2"
SIZE = 100


def at(node: str) -> bytes:
    return IPv4Address(FLEET.address(node)).packed


def ip(source: str, destination: str, *, out: bool) -> bytes:
    """A frame of SIZE bytes at a node's port; `out`: the node has sent it, or passed it on."""
    ends = NET + NODE if out else NODE + NET
    return (ends + b"\x08\0" + bytes(12) + at(source) + at(destination)).ljust(SIZE, b"\0")


def arp(node: str) -> bytes:
    """The node asks who has the address of `net`."""
    return (bytes([255] * 6) + NODE + b"\x08\x06" + bytes(8) + NODE + at(node)).ljust(60, b"\0")


class Watch:
    """Captures in a folder, and a clock that a test moves."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.now_s = folder, 0.0
        self.traffic = Traffic(folder, FLEET.topology(), lambda: self.now_s)

    def see(self, node: str, *frames: bytes, append: bool = False) -> None:
        write_pcap(self.folder / f"{node}.pcap", [(1, frame) for frame in frames], append=append)

    def look(self, after_s: float = 2.0) -> dict[str, Carried]:
        """What carried something."""
        self.now_s += after_s
        return {name: carried for name, carried in self.traffic.look().items() if carried != Carried()}


def test_frames_between_neighbours_are_counted_at_the_lower_one_and_per_second(tmp_path: Path) -> None:
    watch = Watch(tmp_path)
    watch.see("uav1", arp("uav1"), *[ip("uav1", "fog1", out=True)] * 4, ip("fog1", "uav1", out=False))
    watch.see("fog1", arp("fog1"), ip("uav1", "fog1", out=False), ip("fog1", "cloud", out=True))
    assert watch.look() == {
        "air:uav1:up": Carried(2.0, 2.0 * SIZE),
        "air:uav1:down": Carried(0.5, 0.5 * SIZE),
        "backhaul:fog1:up": Carried(0.5, 0.5 * SIZE),
    }


def test_what_nodes_pass_on_is_counted_once_on_each_link(tmp_path: Path) -> None:
    watch = Watch(tmp_path)
    watch.see("fog1", arp("fog1"), ip("uav1", "gs", out=False), ip("uav1", "gs", out=True))
    watch.see("gs", arp("gs"), ip("uav1", "gs", out=False), ip("gs", "uav1", out=True))
    up = Carried(0.5, 0.5 * SIZE)
    assert watch.look() == {"backhaul:fog1:up": up, "wan:gs:down": up, "wan:gs:up": up}


def test_only_what_came_since_the_last_look_is_counted_and_a_cut_frame_when_it_is_whole(tmp_path: Path) -> None:
    watch = Watch(tmp_path)
    watch.see("gs", arp("gs"), ip("gs", "cloud", out=True))
    assert watch.look()["wan:gs:up"].packets_per_s == 0.5
    assert watch.look() == {}
    path = tmp_path / "gs.pcap"
    before = path.read_bytes()
    watch.see("gs", ip("gs", "cloud", out=True), append=True)
    whole = path.read_bytes()
    path.write_bytes(whole[:-10])
    assert watch.look() == {}
    path.write_bytes(whole)
    assert watch.look(0.5)["wan:gs:up"] == Carried(2.0, 2.0 * SIZE)
    assert len(before) < len(whole)


def test_captures_that_are_not_there_yet_or_are_none_carry_nothing(tmp_path: Path) -> None:
    watch = Watch(tmp_path)
    assert watch.look() == {}
    (tmp_path / "gs.pcap").write_bytes(struct.pack("<6I", 1, 2, 3, 4, 5, 6))
    assert watch.look() == {}
    with pytest.raises(ResultsError, match=r"gs\.pcap: not a capture"):
        CaptureTail(tmp_path / "gs.pcap").more()
