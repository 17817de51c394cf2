"""Autopilots' streams, frame by frame: recorded from the stand-in's processes, or computed with exact ticks."""

from __future__ import annotations

import contextlib
import json
import selectors
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from pymavlink.dialects.v20 import development as mavlink

from sitl.fleet import DroneConfig
from sitl.streams import NUMBERS
from sitl.vehicle import Vehicle

ROOT = Path(__file__).resolve().parents[2]
HEADERS = 14 + 20 + 8
"""Headers of Ethernet, IPv4 and UDP. A router forwards one message per datagram, as the autopilot sends them."""
TICK_NS = 10_000_000
WARM_UP_S = 8.0
"""The time from the first datagram until all fly at their height."""
_SO_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@ll")
_SO_RCVBUFFORCE = 33
_KINDS = {number: message.msgname for number, message in mavlink.mavlink_map.items()}
_KINDS |= {number: name for name, number in NUMBERS.items()}


class Frame(NamedTuple):
    """A datagram as an Ethernet frame without FCS; times count from the start of the recording."""

    t_ns: int
    size: int
    kind: str


Streams = Mapping[int, tuple[Frame, ...]]
"""By drone, in the order of time."""


@dataclass(frozen=True)
class Load:
    """A drone's stream in figures."""

    frames_s: float
    kbit_s: float
    size_bytes: float


def load_of(stream: tuple[Frame, ...]) -> Load:
    """The mean load from the first frame to the last."""
    span_s = (stream[-1].t_ns - stream[0].t_ns) / 1e9
    size = sum(frame.size for frame in stream)
    return Load(len(stream) / span_s, size * 8 / span_s / 1000, size / len(stream))


def exact(chosen: str, seconds: float, system: int = 1, start_ns: int = 0) -> tuple[Frame, ...]:
    """The stand-in's own messages in flight, with every tick on time; the first WARM_UP_S are left out."""
    vehicle, codec = Vehicle(DroneConfig(system), [chosen]), mavlink.MAVLink(None, system, 1)
    frames = []
    for tick in range(round((seconds + WARM_UP_S) * 1e9) // TICK_NS):
        now_ns = tick * TICK_NS
        vehicle.advance(now_ns / 1e9)
        if tick == 100:
            for wanted in _take_off(system):
                vehicle.handle(0, wanted)
        for message in vehicle.streamed(0, now_ns / 1e9):
            size = len(message.pack(codec)) + HEADERS
            codec.seq = (codec.seq + 1) % 256
            if now_ns >= WARM_UP_S * 1e9:
                frames.append(Frame(now_ns - round(WARM_UP_S * 1e9) + start_ns, size, message.get_type()))
    return tuple(frames)


def record(chosen: str, drones: int, seconds: float) -> Streams:
    """Record what the stand-in's processes send to loopback in flight, with the kernel's receive times."""
    with flying(chosen, drones) as stand_ins:
        return stand_ins.listen(seconds)


class StandIns:
    """Stand-ins in flight, by their processes, and what they send."""

    def __init__(self, processes: list[subprocess.Popen[bytes]], sockets: Mapping[int, socket.socket]) -> None:
        self.pids = [process.pid for process in processes]
        self._sockets = sockets
        self._up_ns = _start(sockets) + round(WARM_UP_S * 1e9)

    def listen(self, seconds: float) -> Streams:
        """What comes from now on, or from when all fly at their height."""
        begin_ns = max(time.time_ns(), self._up_ns)
        found = _listen(self._sockets, begin_ns, begin_ns + round(seconds * 1e9))
        return {drone: tuple(frames) for drone, frames in found.items()}


@contextlib.contextmanager
def flying(chosen: str, drones: int) -> Iterator[StandIns]:
    """Stand-ins that have taken off."""
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        sockets = {drone: stack.enter_context(_receiver()) for drone in range(1, drones + 1)}
        processes = [
            stack.enter_context(_flying(chosen, drone, come.getsockname()[1], folder))
            for drone, come in sockets.items()
        ]
        yield StandIns(processes, sockets)


def write(path: Path, streams: Streams) -> None:
    """Write streams as JSON: for each drone its frames as [t_ns, size, kind]."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(dict(streams)))


def read(path: Path) -> Streams:
    """Read streams that `write` has written."""
    return {
        int(drone): tuple(Frame(*frame) for frame in frames) for drone, frames in json.loads(path.read_text()).items()
    }


def _take_off(system: int) -> Iterator[mavlink.MAVLink_message]:
    """A ground station's messages to arm and take off, as received."""
    sender, receiver = mavlink.MAVLink(None, 245, 190), mavlink.MAVLink(None)
    for command, first in ((400, 1.0), (22, 0.0)):
        message = mavlink.MAVLink_command_long_message(system, 1, command, 0, first, 0, 0, 0, 0, 0, 1000.0)
        yield from receiver.parse_buffer(message.pack(sender))


@contextlib.contextmanager
def _receiver() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as come:
        come.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        with contextlib.suppress(PermissionError):
            come.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, 8 << 20)
        come.bind(("127.0.0.1", 0))
        come.setblocking(False)
        yield come


@contextlib.contextmanager
def _flying(chosen: str, drone: int, port: int, folder: str) -> Iterator[subprocess.Popen[bytes]]:
    options = ["--system", str(drone), "--listen", "127.0.0.1:0", "--send", f"127.0.0.1:{port}", "--streams", chosen]
    command = [sys.executable, "-m", "sitl", "fly", *options, "--events", f"{folder}/{drone}.jsonl"]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.terminate()


def _start(sockets: Mapping[int, socket.socket]) -> int:
    """Answer each drone's first datagram with arm and takeoff; returns when the last was answered, ns since 1970."""
    for drone, come in sockets.items():
        come.setblocking(True)
        come.settimeout(120)
        _, autopilot = come.recvfrom(2048)
        for message in _take_off(drone):
            come.sendto(message.get_msgbuf(), autopilot)
        come.setblocking(False)
    return time.time_ns()


def _listen(sockets: Mapping[int, socket.socket], begin_ns: int, end_ns: int) -> dict[int, list[Frame]]:
    found: dict[int, list[Frame]] = {drone: [] for drone in sockets}
    with selectors.DefaultSelector() as selector:
        for drone, come in sockets.items():
            selector.register(come, selectors.EVENT_READ, found[drone])
        while time.time_ns() < end_ns:
            for key, _ in selector.select(timeout=0.5):
                assert isinstance(key.fileobj, socket.socket)
                _take(key.fileobj, key.data, begin_ns, end_ns)
    return found


def _take(come: socket.socket, frames: list[Frame], begin_ns: int, end_ns: int) -> None:
    """Read everything that waits at a socket."""
    with contextlib.suppress(BlockingIOError):
        while True:
            data, ancillary, _, _ = come.recvmsg(2048, 64)
            seconds, nanoseconds = _TIMESPEC.unpack(ancillary[0][2])
            t_ns = seconds * 1_000_000_000 + nanoseconds
            if begin_ns <= t_ns < end_ns:
                kind = _KINDS[int.from_bytes(data[7:10], "little")]
                frames.append(Frame(t_ns - begin_ns, len(data) + HEADERS, kind))
