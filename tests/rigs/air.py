"""A fog whose drone connects by MQTT-SN, as real processes, with `LossyAir` between drone and activator."""

from __future__ import annotations

import socket
from pathlib import Path

from tests.rigs.loopback import free_port
from tests.rigs.lossy_air import LossyAir
from tests.rigs.one_drone import SIGNED, OneDrone

BY_AIR = "is connected"


class AirSystem(OneDrone):
    """An activator with `--air-sn`, and a drone that connects by it; with `and_tcp` over TCP, too."""

    def __init__(self, folder: Path, *, signed: bool = False, and_tcp: bool = False) -> None:
        super().__init__(folder, SIGNED if signed else "", air=True)
        self.air_port = free_port(socket.SOCK_DGRAM)
        self.air = LossyAir(self.air_port)
        second = ["--second-broker", self.url(self.fog.port)] if and_tcp else []
        self.run(["--air-sn", f"127.0.0.1:{self.air_port}"], ["--broker", self.air.url, *second])

    async def begin(self) -> None:
        await self.air.start()
        await super().begin()

    async def end(self) -> None:
        await super().end()
        self.air.close()

    def has_connected(self, times: int) -> bool:
        return self.connections() >= times

    def connections(self) -> int:
        """How often the drone has connected through the gateway."""
        return self.activator.said().count(BY_AIR)
