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
from tests.rigs.commanding import controlled
from tests.rigs.loopback import free_port
from tests.rigs.processes import Broker, Process, commanded, stand_in
from tests.rigs.secure import SecureBroker

TLS, SIGNED = "tls", "signed"
STATION = Rights(None, take_over=True, observe=True)


class OneDrone:
    """`mode` is "", TLS or SIGNED; with the latter two each node has an identity of the fleet `acme`.

    A rig adds the way between drone and fog: options for both (`run`), more brokers, links that it begins and ends.
    """

    signs_readings = False

    def __init__(self, folder: Path, mode: str = "", *, air: bool = False, prefix: str = "") -> None:
        self.folder = folder
        self.is_signed = mode == SIGNED
        self.acme = Authority.create(folder / "acme", "acme") if mode else None
        if self.acme is not None:
            for name in ("fog1", "drone1"):
                self.acme.issue(name)
            self.acme.issue("gs-ops", STATION)
        self._scheme = "mqtts" if mode else "mqtt"
        self.cloud = self.broker("cloud", self.acme, prefix=prefix)
        self.fog = self.broker("fog1", self.acme, air=air)
        self.brokers = [self.cloud, self.fog]
        self.journal = folder / "journal"
        self._autopilot = free_port(socket.SOCK_DGRAM)
        self.sitl = stand_in(folder, 1, self._autopilot, name="sitl", fleet=quick_fleet(folder, LANDING))

    def run(self, activator: Sequence[str], uav: Sequence[str], ppm: int | None = None) -> None:
        """Make both programs, with these options besides the usual ones; `ppm` is the rate of the drone's clock."""
        brokers = ["--cloud", self.cloud_url, "--fog-broker", self.url(self.fog.port)]
        journal = ["--journal", str(self.journal), "--autopilot", f"udp:127.0.0.1:{self._autopilot}"]
        activator = ["--fog", "1", "--drones", "1", *brokers, *activator, *self.identity("fog1")]
        uav = ["--drone", "1", *journal, *uav, *self.identity("drone1"), *(["--fog", "1"] if self.is_signed else [])]
        self.activator = self.process("activator", "mqttxt", "activator", *activator)
        self.uav = self.process("uav", "mqttxt", "uav", *uav, ppm=ppm)

    def identity(self, name: str) -> list[str]:
        signed = ["--signed"] if self.is_signed else []
        return ["--identity", str(self.acme.folder / name), *signed] if self.acme is not None else []

    def broker(
        self, of: str, authority: Authority | None, called: str | None = None, *, air: bool = False, prefix: str = ""
    ) -> Broker | SecureBroker:
        if authority is None:
            return Broker(self.folder, called or of)
        name = f"broker-{of}"
        if not (authority.folder / name).exists():
            authority.issue(name)
        return SecureBroker(authority, name, prefix, called=called, air=air)

    def url(self, port: int) -> str:
        return f"{self._scheme}://127.0.0.1:{port}"

    @property
    def cloud_url(self) -> str:
        return self.url(self.cloud.port)

    def process(self, name: str, module: str, *arguments: str, ppm: int | None = None) -> Process:
        ready = str(self.folder / f"{name}.ready")
        return Process(self.folder, name, module, *arguments, "--ready-file", ready, ppm=ppm)

    @property
    def processes(self) -> tuple[Process, ...]:
        return self.sitl, self.activator, self.uav

    def start(self) -> None:
        for broker in self.brokers:
            broker.start()
        for process in self.processes:
            process.start()
        for process in self.processes:
            process.wait_ready()

    def close(self) -> None:
        for process in self.processes:
            process.kill()
        for broker in self.brokers:
            broker.kill()

    async def begin(self) -> None:
        """Start everything; a rig starts its links first."""
        await asyncio.to_thread(self.start)

    async def end(self) -> None:
        self.close()

    def station(self, name: str = "gs-ops", signed: bool | None = None) -> GroundStation:
        """A ground station that signs if the fleet does, or as `signed` says."""
        folder = self.acme.folder / name if self.acme is not None else None
        signs = self.is_signed if signed is None else signed
        readings = signs and self.signs_readings
        return GroundStation(self.cloud_url, identity=folder, signed=signs, signed_readings=readings)

    @asynccontextmanager
    async def flying(self) -> AsyncIterator[tuple[GroundStation, Drone]]:
        """Yield a station and drone 1, which it controls; asserts that activator and UAV client run to the end."""
        try:
            await self.begin()
            async with self.station() as station:
                yield station, await controlled(station)
                assert self.uav.exit_code is None
                assert self.activator.exit_code is None
        finally:
            await self.end()

    def commanded(self, mav_cmd: int) -> int:
        """How often the autopilot received a MAV_CMD."""
        return len(commanded(self.folder / "sitl.jsonl", mav_cmd))
