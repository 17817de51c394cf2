"""Captures loopback with the testbed image's tcpdump: frames as Ethernet would carry them, with their headers."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from scapy.utils import RawPcapReader

from tests.rigs.tcpdump import Tcpdump


@dataclass(frozen=True)
class Frame:
    """A frame: its capture time (Unix, s), its ports, its length and that of its TCP or UDP payload, in bytes."""

    time_s: float
    source: int
    target: int
    size: int
    carried: int


class Capture:
    """Every frame of TCP or UDP on loopback to or from some ports, while the context lasts; then `frames`."""

    def __init__(self, folder: Path, ports: list[int]) -> None:
        self.frames: list[Frame] = []
        self._file = folder / "capture" / "lo.pcap"
        self._file.parent.mkdir(exist_ok=True)
        self._tcpdump = Tcpdump(self._file, " or ".join(f"port {port}" for port in ports), "-B", "8192", "-s", "96")

    def __enter__(self) -> Self:
        self._tcpdump.__enter__()
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            if kind is None:
                self._tcpdump.end()
                assert self._tcpdump.dropped() == [0]
                self.frames = read(self._file)
        finally:
            self._tcpdump.__exit__()

    def between(self, start_s: float, end_s: float) -> list[Frame]:
        return [frame for frame in self.frames if start_s <= frame.time_s < end_s]


def read(path: Path) -> list[Frame]:
    """The IPv4 frames of a capture in microseconds, with Ethernet headers."""
    frames, ip = [], 14
    with RawPcapReader(str(path)) as reader:
        for data, meta in reader:
            behind_ip = ip + 4 * (data[ip] & 15)
            is_tcp = data[ip + 9] == 6
            source, target = struct.unpack_from("!HH", data, behind_ip)
            headers = behind_ip + (4 * (data[behind_ip + 12] >> 4) if is_tcp else 8)
            frames.append(Frame(meta.sec + meta.usec / 1e6, source, target, meta.wirelen, meta.wirelen - headers))
    return frames
