"""A fog with one drone, as real processes: cloud's and fog's broker, activator, UAV client and autopilot."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from mqttxt import Drone, GroundStation
from mqttxt.security.authority import Authority
from mqttxt.security.rights import Rights
from tests.quick import LANDING, quick_fleet
from tests.rigs.loopback import eventually, free_port
from tests.rigs.processes import Broker, Process, commanded
from tests.rigs.secure import SecureBroker

TLS, SIGNED = "tls", "signed"
STATION = Rights(None, take_over=True, observe=True)


class OneDrone:
    """`mode` is "", TLS or SIGNED: with one of the latter each node has an identity of the fleet `acme`.

    A rig adds what is between drone and fog: options for both (`run`), more brokers, links that it starts and closes.
    """

    def __init__(self, folder: Path, mode: str = "", *, air: bool = False) -> None:
        self.folder = folder
        self.is_signed = mode == SIGNED
        self.acme = Authority.create(folder / "acme", "acme") if mode else None
        if self.acme is not None:
            for name in ("fog1", "drone1"):
                self.acme.issue(name)
            self.acme.issue("gs-ops", STATION)
        self._scheme = "mqtts" if mode else "mqtt"
        self.cloud, self.fog = self.broker("cloud", self.acme), self.broker("fog1", self.acme, air=air)
        self.brokers = [self.cloud, self.fog]
        self._autopilot = free_port(socket.SOCK_DGRAM)
        there = ["--listen", "127.0.0.1:0", "--send", f"127.0.0.1:{self._autopilot}"]
        fleet = ["--fleet", str(quick_fleet(folder, LANDING)), "--system", "1"]
        self.sitl = self._process("sitl", "sitl", "fly", *fleet, *there, "--events", str(folder / "sitl.jsonl"))

    def run(self, activator: Sequence[str], uav: Sequence[str], ppm: int | None = None) -> None:
        """Make both programs, with these options beside the usual ones; `ppm` is the drone's clock."""
        brokers = ["--cloud", self.url(self.cloud.port), "--fog-broker", self.url(self.fog.port)]
        journal = ["--journal", str(self.folder / "journal"), "--autopilot", f"udp:127.0.0.1:{self._autopilot}"]
        activator = ["--fog", "1", "--drones", "1", *brokers, *activator, *self._identity("fog1")]
        uav = ["--drone", "1", *journal, *uav, *self._identity("drone1"), *(["--fog", "1"] if self.is_signed else [])]
        self.activator = self._process("activator", "mqttxt", "activator", *activator)
        self.uav = self._process("uav", "mqttxt", "uav", *uav, ppm=ppm)

    def _identity(self, name: str) -> list[str]:
        signed = ["--signed"] if self.is_signed else []
        return ["--identity", str(self.acme.folder / name), *signed] if self.acme is not None else []

    def broker(
        self, of: str, authority: Authority | None, called: str | None = None, *, air: bool = False
    ) -> Broker | SecureBroker:
        if authority is None:
            return Broker(self.folder, called or of)
        name = f"broker-{of}"
        if not (authority.folder / name).exists():
            authority.issue(name)
        return SecureBroker(authority, name, called=called, air=air)

    def url(self, port: int) -> str:
        return f"{self._scheme}://127.0.0.1:{port}"

    def _process(self, name: str, module: str, *arguments: str, ppm: int | None = None) -> Process:
        ready = str(self.folder / f"{name}.ready")
        return Process(self.folder, name, module, *arguments, "--ready-file", ready, ppm=ppm)

    @property
    def _processes(self) -> tuple[Process, ...]:
        return self.sitl, self.activator, self.uav

    async def start(self) -> None:
        for broker in self.brokers:
            await asyncio.to_thread(broker.start)
        for process in self._processes:
            process.start()
        for process in self._processes:
            await asyncio.to_thread(process.wait_ready)

    async def close(self) -> None:
        for process in self._processes:
            process.kill()
        for broker in self.brokers:
            broker.kill()

    def station(self) -> GroundStation:
        folder = self.acme.folder / "gs-ops" if self.acme is not None else None
        return GroundStation(self.url(self.cloud.port), identity=folder, signed=self.is_signed)

    @asynccontextmanager
    async def flying(self) -> AsyncIterator[tuple[GroundStation, Drone]]:
        """A station, and drone 1, which that controls; neither the activator nor the UAV client ends meanwhile."""
        try:
            await self.start()
            async with self.station() as station:
                (fog,) = await station.connect([1])
                drone = fog.drone(1)
                await eventually(lambda: drone.is_reachable and drone.is_controlled, "drone 1 is there")
                yield station, drone
                assert self.uav.exit_code is None
                assert self.activator.exit_code is None
        finally:
            await self.close()

    def commanded(self, mav_cmd: int) -> int:
        """How often the autopilot received a MAV_CMD."""
        return len(commanded(self.folder / "sitl.jsonl", mav_cmd))
