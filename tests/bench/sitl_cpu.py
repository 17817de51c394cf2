"""The CPU of six stand-ins in flight at PX4's onboard rates, their traffic, and whether they keep the rates."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import cast

from pymavlink.dialects.v20 import common as mavlink

from sitl.px4.streams import rates_hz
from sitl.streams import number
from tests.bench.brokers import cpu_s

ROOT = Path(__file__).resolve().parents[2]
DRONES = 6
WARM_UP_S, WINDOW_S = 3.0, 10.0
STEADY_HZ = 5
"""Slower streams have too few messages in the window to be judged."""


class _Receiver(asyncio.DatagramProtocol):
    """Counts datagrams and their bytes, and answers the first with arm and takeoff."""

    def __init__(self) -> None:
        self.counts: Counter[int] = Counter()
        """By message number."""
        self.size_bytes = 0
        self._flies = False
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.counts[int.from_bytes(data[7:10], "little")] += 1
        self.size_bytes += len(data)
        if not self._flies and self._transport is not None:
            self._flies = True
            codec = mavlink.MAVLink(None, 245, 190)
            for command, first in ((400, 1.0), (22, 0.0)):
                message = mavlink.MAVLink_command_long_message(0, 1, command, 0, first, 0, 0, 0, 0, 0, 1000.0)
                self._transport.sendto(message.pack(codec), addr)


def measure() -> list[str]:
    """One line of figures; takes about 15 s."""
    return [asyncio.run(_measure())]


async def _measure() -> str:
    loop = asyncio.get_running_loop()
    receivers, transports, processes = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        try:
            for drone in range(1, DRONES + 1):
                transport, receiver = await loop.create_datagram_endpoint(_Receiver, ("127.0.0.1", 0))
                send = "127.0.0.1:{}".format(transport.get_extra_info("sockname")[1])
                options = ["--system", str(drone), "--listen", "127.0.0.1:0", "--send", send]
                events = ["--events", f"{folder}/{drone}.jsonl"]
                command = [sys.executable, "-m", "sitl", "fly", *options, *events]
                processes.append(subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL))
                receivers.append(receiver)
                transports.append(transport)
            while not all(receiver.counts for receiver in receivers):
                await asyncio.sleep(0.1)
            await asyncio.sleep(WARM_UP_S)
            before = (
                time.monotonic(),
                cpu_s(*(process.pid for process in processes)),
                sum(r.size_bytes for r in receivers),
            )
            counted = [Counter(r.counts) for r in receivers]
            await asyncio.sleep(WINDOW_S)
            after = (
                time.monotonic(),
                cpu_s(*(process.pid for process in processes)),
                sum(r.size_bytes for r in receivers),
            )
            counted = [r.counts - before for r, before in zip(receivers, counted, strict=True)]
        finally:
            for process in processes:
                process.terminate()
            for process in processes:
                process.wait()
            for transport in transports:
                transport.close()
    wall_s, used_s, size_bytes = (b - a for a, b in zip(before, after, strict=True))
    messages = sum(found.total() for found in counted)
    rate = messages / wall_s / DRONES
    wire_kbit_s = (size_bytes + 28 * messages) * 8 / 1000 / wall_s / DRONES
    return (
        f"sitl: {DRONES} drones climbing at onboard rates take {100 * used_s / wall_s:.1f} % of one core; "
        f"each sends {rate:.0f} messages/s, {wire_kbit_s:.0f} kbit/s with UDP/IP; "
        f"a stream of {STEADY_HZ} Hz or more is off PX4's rate by {100 * _worst(counted, wall_s):.1f} % at most"
    )


def _worst(counted: list[Counter[int]], wall_s: float) -> float:
    """The largest deviation of a drone's stream from its rate, as a part of it."""
    wanted = {number(name): hz for name, hz in rates_hz("px4-onboard").items()}
    steady = {number: hz for number, hz in wanted.items() if hz >= STEADY_HZ}
    return max(abs(found[number] / wall_s / hz - 1) for found in counted for number, hz in steady.items())
