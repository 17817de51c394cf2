"""The CPU of a UAV client in flight, beside an autopilot that sends all that PX4 sends to a companion computer."""

from __future__ import annotations

import asyncio
import math
import socket
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from tests.bench.brokers import BenchBroker, cpu_s, rss_mb
from tests.bench.raw_mqtt import RawClient
from tests.rigs.processes import Process, free_port

WARM_UP_S, WINDOW_S = 6.0, 10.0
_FAR = (474_977_420, 85_455_940)
"""Degrees in 1e-7, 11 km north of the stand-in's home: the flight there outlasts the measurement."""


def measure() -> list[str]:
    """One line of figures; takes about 20 s."""
    return [asyncio.run(_measure())]


async def _measure() -> str:
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        broker = BenchBroker(folder, "fog").start()
        stack.callback(broker.kill)
        listen, send = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
        ports = ["--listen", f"127.0.0.1:{listen}", "--send", f"127.0.0.1:{send}"]
        files = ["--events", str(folder / "sitl.jsonl"), "--ready-file", str(folder / "sitl.ready")]
        sitl = Process(folder, "sitl", "sitl", "fly", "--system", "1", *ports, *files).start()
        stack.callback(sitl.kill)
        options = ["--drone", "1", "--broker", broker.url, "--autopilot", f"udp:127.0.0.1:{send}"]
        files = ["--journal", str(folder / "journal"), "--ready-file", str(folder / "uav.ready")]
        uav = Process(folder, "uav", "mqttxt", "uav", *options, *files).start()
        stack.callback(uav.kill)
        await asyncio.to_thread(uav.wait_ready)
        listener = await RawClient.connect(broker.port, "bench")
        stack.callback(listener.close)
        await listener.subscribe("drone1/state/#")
        await asyncio.to_thread(_fly_away, listen)
        await asyncio.sleep(WARM_UP_S)
        before = (time.monotonic(), cpu_s(uav.pid), listener.received)
        await asyncio.sleep(WINDOW_S)
        after = (time.monotonic(), cpu_s(uav.pid), listener.received)
        wall_s, used_s, states = (b - a for a, b in zip(before, after, strict=True))
        return (
            f"uav client: {100 * used_s / wall_s:.1f} % of one core at PX4's onboard rates, in flight "
            f"({states / wall_s:.1f} states a second published, {rss_mb(uav.pid):.0f} MB resident)"
        )


def _fly_away(port: int) -> None:
    """Arm, take off and go far, straight over MAVLink."""
    codec = mavlink.MAVLink(None, 245, 190)
    nan = math.nan
    arm = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    takeoff = mavlink.MAVLink_command_long_message(1, 1, 22, 0, nan, nan, nan, nan, nan, nan, nan)
    goto = mavlink.MAVLink_command_int_message(1, 1, 0, 192, 0, 0, -1, 1, 0, nan, *_FAR, 520)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for message, pause_s in ((arm, 0.5), (takeoff, 4.0), (goto, 0.0)):
            sock.sendto(message.pack(codec), ("127.0.0.1", port))
            time.sleep(pause_s)
