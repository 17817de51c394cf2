"""Bytes on the wire of six drones with five states per second over three hops: bundles, topics, and MAVLink.

Drone to fog, fog to cloud, cloud to ground station; everything on those connections counts: states, beacons,
leases, and every ACK. MAVLink's bytes are those of the same autopilots' messages, over UDP, on as many hops.
CLOUD_MOSQUITTO names the program of another Mosquitto, 2.1 or newer, as the cloud's broker, with aliases towards its
clients.
"""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from mqttxt import GroundStation
from tests.bench.brokers import BenchBroker
from tests.bench.capture import Capture, Frame
from tests.bench.vital import packed, telemetry
from tests.rigs.processes import Process, eventually, free_port

FOGS = {1: (1, 2, 3), 2: (4, 5, 6)}
STATES = ("battery", "location", "heading", "groundspeed", "flight_mode")
HOPS = 3
SETTLE_S, WINDOW_S = 3.0, 20.0
"""The window holds two intervals of beacons and leases."""


@dataclass(frozen=True)
class Load:
    """Bytes per second on each hop, and of the same states by MAVLink on one hop."""

    hops: tuple[float, float, float]
    mavlink: float

    @property
    def ratio(self) -> float:
        return sum(self.hops) / (HOPS * self.mavlink)

    def __str__(self) -> str:
        apiece = ", ".join(f"{hop:,.0f}" for hop in self.hops)
        return f"{sum(self.hops):,.0f} bytes a second ({apiece}) beside MAVLink's {HOPS * self.mavlink:,.0f}"


def measure() -> list[str]:
    """Lines of figures; takes about a minute and a half, twice that beside another Mosquitto."""
    lines = []
    for program in (None, *filter(None, [os.environ.get("CLOUD_MOSQUITTO")])):
        cloud = "" if program is None else f", {_version(program)} in the cloud"
        for bundles, how in ((True, "bundled"), (False, "topic by topic")):
            load = asyncio.run(_measure(bundles, program))
            lines.append(f"six drones, five states a second, three hops, {how}{cloud}: {load}: {load.ratio:.2f} times")
    return lines


def _version(program: str) -> str:
    said = subprocess.run([program, "-h"], capture_output=True, text=True, check=False).stdout
    return next(line for line in said.splitlines() if line.startswith("mosquitto version"))


class _Broker(BenchBroker):
    """A broker with a second port, so that a capture can tell connections apart by their ports.

    `program`: a Mosquitto with aliases of its own, in place of the nodes' version.
    """

    def __init__(self, folder: Path, name: str, program: str | None = None) -> None:
        self.second = free_port()
        aliases = "" if program is None else "max_topic_alias_broker 4096\n"
        super().__init__(folder, name, f"listener {self.second} 127.0.0.1\nmax_topic_alias 4096\n{aliases}", program)

    @property
    def second_url(self) -> str:
        return f"mqtt://127.0.0.1:{self.second}"


async def _measure(bundles: bool, program: str | None) -> Load:
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        cloud, *fogs = _Broker(folder, "cloud", program), *(_Broker(folder, f"fog{fog}") for fog in FOGS)
        autopilots = {drone: free_port(socket.SOCK_DGRAM) for drones in FOGS.values() for drone in drones}
        for broker in (cloud, *fogs):
            stack.callback(broker.start().kill)
        telling = asyncio.create_task(_tell(autopilots))
        processes = _processes(folder, cloud, fogs, autopilots, bundles)
        for process in processes:
            stack.callback(process.start().kill)
        for process in processes:
            await asyncio.to_thread(process.wait_ready)
        fog_ports = [fog.port for fog in fogs]
        capture = Capture(folder, [cloud.port, cloud.second, *fog_ports, *autopilots.values()])
        async with GroundStation(cloud.second_url, bundles=bundles) as station:
            there = await station.connect(FOGS)
            drones = [fog.drone(drone) for fog in there for drone in FOGS[fog.number]]
            await eventually(lambda: all(set(STATES) <= drone.states.keys() for drone in drones), "every state")
            with capture:
                await asyncio.sleep(SETTLE_S)
                start_s = time.time()
                await asyncio.sleep(WINDOW_S)
                end_s = time.time()
        telling.cancel()
    frames = capture.between(start_s, end_s)
    hops = (_bytes(frames, fog_ports), _bytes(frames, [cloud.port]), _bytes(frames, [cloud.second]))
    told = sum(frame.size for frame in frames if frame.target in autopilots.values()) / WINDOW_S
    return Load(hops, told)


def _bytes(frames: list[Frame], ports: list[int]) -> float:
    """Bytes per second in both directions."""
    return sum(frame.size for frame in frames if frame.source in ports or frame.target in ports) / WINDOW_S


def _processes(
    folder: Path, cloud: _Broker, fogs: list[_Broker], autopilots: dict[int, int], bundles: bool
) -> list[Process]:
    made = []
    for (fog, drones), broker in zip(FOGS.items(), fogs, strict=True):
        urls = ["--cloud", cloud.url, "--fog-broker", broker.second_url]
        ready = ["--ready-file", str(folder / f"activator{fog}.ready")]
        made.append(Process(folder, f"activator{fog}", "mqttxt", "activator", "--fog", str(fog), *urls, *ready))
        for drone in drones:
            form = "bundles" if bundles else "topics"
            options = [str(drone), broker.url, str(autopilots[drone]), str(folder), form]
            made.append(Process(folder, f"uav{drone}", "tests.bench.steady_uav", *options))
    return made


async def _tell(autopilots: dict[int, int]) -> None:
    """Send each autopilot's messages once per second; drones are not in step with each other."""
    loop = asyncio.get_running_loop()
    started_s = loop.time()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for turn in range(10**6):
            second, which = divmod(turn, len(autopilots))
            drone = sorted(autopilots)[which]
            for message in telemetry(second):
                sock.sendto(packed(message, drone), ("127.0.0.1", autopilots[drone]))
            await asyncio.sleep(max(0, started_s + (turn + 1) / len(autopilots) - loop.time()))
