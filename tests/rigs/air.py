"""A fog whose drone comes by MQTT-SN, as real processes; between drone and activator is `LossyAir`."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path
from typing import Self

from mqttxt import GroundStation
from mqttxt.security.authority import Authority
from mqttxt.security.rights import Rights
from tests.quick import LANDING, quick_fleet
from tests.rigs.lossy_air import LossyAir
from tests.rigs.processes import Broker, Process, commanded, free_port
from tests.rigs.secure import SecureBroker

STATION = Rights(None, take_over=True, observe=True)
BY_AIR = "is connected"


class AirSystem:
    """Cloud's and fog's broker, an activator with `--air-sn`, drone 1 and its autopilot; `signed` with identities.

    With `by_tcp` the drone comes as ever: what is the same beside the leg.
    """

    def __init__(self, folder: Path, *of_the_drone: str, signed: bool = False, by_tcp: bool = False) -> None:
        self.folder = folder
        self.acme = Authority.create(folder / "acme", "acme") if signed else None
        if self.acme is not None:
            for name in ("broker-cloud", "broker-fog1", "fog1", "drone1"):
                self.acme.issue(name)
            self.acme.issue("gs-ops", STATION)
            cloud, fog = SecureBroker(self.acme, "broker-cloud"), SecureBroker(self.acme, "broker-fog1", air=True)
            self.cloud: Broker | SecureBroker = cloud
            self.fog: Broker | SecureBroker = fog
            urls = [str(cloud.address), str(fog.address)]
        else:
            self.cloud, self.fog = Broker(folder, "cloud"), Broker(folder, "fog1")
            urls = [self.cloud.url, self.fog.url]
        self.air_port = free_port(socket.SOCK_DGRAM)
        self.air = LossyAir(self.air_port)
        self.cloud_url, self.fog_url = urls
        autopilot = free_port(socket.SOCK_DGRAM)
        fleet = str(quick_fleet(folder, LANDING))
        sitl = ["fly", "--fleet", fleet, "--system", "1", "--listen", "127.0.0.1:0", "--send", f"127.0.0.1:{autopilot}"]
        self.sitl = self._process("sitl", "sitl", *sitl, "--events", str(folder / "sitl.jsonl"))
        activator = ["activator", "--fog", "1", "--cloud", urls[0], "--fog-broker", urls[1], "--drones", "1"]
        uav = ["uav", "--drone", "1", "--autopilot", f"udp:127.0.0.1:{autopilot}", "--journal", str(folder / "journal")]
        uav += ["--broker", urls[1] if by_tcp else self.air.url, *of_the_drone]
        if self.acme is not None:
            activator += ["--identity", str(self.acme.folder / "fog1"), "--signed"]
            uav += ["--identity", str(self.acme.folder / "drone1"), "--signed", "--fog", "1"]
        self.activator = self._process("activator", "mqttxt", *activator, "--air-sn", f"127.0.0.1:{self.air_port}")
        self.uav = self._process("uav", "mqttxt", *uav)

    def _process(self, name: str, module: str, *arguments: str) -> Process:
        return Process(self.folder, name, module, *arguments, "--ready-file", str(self.folder / f"{name}.ready"))

    async def start(self) -> Self:
        await self.air.start()
        for broker in (self.cloud, self.fog):
            await asyncio.to_thread(broker.start)
        for process in (self.sitl, self.activator, self.uav):
            process.start()
        for process in (self.sitl, self.activator, self.uav):
            await asyncio.to_thread(process.wait_ready)
        return self

    async def close(self) -> None:
        for process in (self.uav, self.activator, self.sitl):
            await asyncio.to_thread(process.kill)
        for broker in (self.fog, self.cloud):
            await asyncio.to_thread(broker.kill)
        self.air.close()

    def station(self) -> GroundStation:
        folder = self.acme.folder / "gs-ops" if self.acme is not None else None
        return GroundStation(self.cloud_url, identity=folder, signed=self.acme is not None)

    def commanded(self, mav_cmd: int) -> int:
        """How often the autopilot received a MAV_CMD."""
        return len(commanded(self.folder / "sitl.jsonl", mav_cmd))

    def has_connected(self, times: int) -> bool:
        return self.connections() >= times

    def connections(self) -> int:
        """How often the drone has connected by the gateway."""
        return self.activator.said().count(BY_AIR)
