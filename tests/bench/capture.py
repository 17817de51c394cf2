"""Captures loopback with the testbed image's tcpdump: frames as Ethernet would carry them, with their headers."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import docker

from testbed.bootstrap.images import NODE
from tests.rigs.processes import wait_until


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
        self._ports = ports
        self._folder = folder / "capture"
        self._container: Any = None

    def __enter__(self) -> Self:
        self._folder.mkdir(exist_ok=True)
        self._folder.chmod(0o777)
        wanted = " or ".join(f"port {port}" for port in self._ports)
        options = [
            "-i",
            "lo",
            "-U",
            "--immediate-mode",
            "-B",
            "8192",
            "-s",
            "96",
            "-Z",
            "root",
            "-w",
            "/capture/lo.pcap",
        ]
        self._container = docker.from_env().containers.run(
            NODE,
            [*options, wanted],
            entrypoint="tcpdump",
            network_mode="host",
            user="0:0",
            cap_add=["NET_RAW", "NET_ADMIN"],
            volumes={str(self._folder): {"bind": "/capture", "mode": "rw"}},
            detach=True,
        )
        wait_until(lambda: b"listening on" in self._container.logs(), "tcpdump listens")
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            self._container.kill(signal="SIGINT")
            self._container.wait()
            said = self._container.logs().decode()
            if kind is None:
                assert "\n0 packets dropped by kernel" in said, said
                self.frames = read((self._folder / "lo.pcap").read_bytes())
        finally:
            self._container.remove(force=True)

    def between(self, start_s: float, end_s: float) -> list[Frame]:
        return [frame for frame in self.frames if start_s <= frame.time_s < end_s]


def read(pcap: bytes) -> list[Frame]:
    """The IPv4 frames of a capture file in microseconds, with Ethernet headers."""
    magic, kind = struct.unpack_from("<I", pcap)[0], struct.unpack_from("<I", pcap, 20)[0]
    assert (magic, kind) == (0xA1B2C3D4, 1), "expected a little-endian pcap of Ethernet frames"
    frames, at = [], 24
    while at + 16 <= len(pcap):
        seconds, micros, kept, size = struct.unpack_from("<IIII", pcap, at)
        data = pcap[at + 16 : at + 16 + kept]
        at += 16 + kept
        ip = 14
        behind_ip = ip + 4 * (data[ip] & 15)
        is_tcp = data[ip + 9] == 6
        source, target = struct.unpack_from("!HH", data, behind_ip)
        headers = behind_ip + (4 * (data[behind_ip + 12] >> 4) if is_tcp else 8)
        frames.append(Frame(seconds + micros / 1e6, source, target, size, size - headers))
    return frames
