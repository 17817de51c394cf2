"""The gateway in front of two drones, and its users' clients as tests use them."""

from __future__ import annotations

import asyncio
import math
import socket
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from tests.rigs.far_link import Far
from tests.rigs.processes import PATIENCE_S, Process, System, free_port, wait_until
from tests.rigs.secure_system import SecureSystem
from tests.simulation.far import FarLink

NAN = math.nan


class Ground(System):
    """Two drones that publish every state, and a gateway: a UDP client listens on `udp`, TCP clients connect to `tcp`.

    With `link`, the gateway reaches the cloud broker over that link.
    """

    def __init__(self, folder: Path, *options: str, link: FarLink | None = None) -> None:
        super().__init__(folder)
        self.far = Far(self.cloud.port, link) if link is not None else None
        self.udp, self.tcp = free_port(socket.SOCK_DGRAM), free_port()
        where = ["--to", f"udp:127.0.0.1:{self.udp}", "--listen", f"tcp:127.0.0.1:{self.tcp}"]
        cloud = self.cloud.url if self.far is None else f"mqtt://127.0.0.1:{self.far.port}"
        station = ["gs", "mavlink", "--fog", "1", "--cloud", cloud]
        self.gateway = Process(folder, "gateway", "mqttxt", *station, *where, *options)

    def make_uav(self, drone: int, broker: str, **how: Any) -> Process:
        return super().make_uav(drone, broker, **how).with_more("--all-states")

    def start(self) -> Ground:
        super().start()
        if self.far is not None:
            self.far.start()
        self.gateway.start()
        wait_until(lambda: "drone 2: is there" in self.gateway.log.read_text(), "the gateway shows both drones")
        return self

    def close(self) -> None:
        self.gateway.kill()
        if self.far is not None:
            self.far.close()
        super().close()


@contextmanager
def signing_client(system: SecureSystem, name: str) -> Iterator[Client]:
    """A client of a gateway with the identity `name`, in a fleet that signs; it has heard its drone."""
    port = free_port()
    where = ["--fog", "1", "--cloud", system.cloud_url, "--listen", f"tcp:127.0.0.1:{port}", "--take-over"]
    gateway = Process(system.folder, name, "mqttxt", "gs", "mavlink", *where, *system.identity(name)).start()
    try:
        wait_until(lambda: "drone 1: is there" in gateway.log.read_text(), "the gateway shows the drone")
        with closing(Client(port)) as client:
            client.until(lambda message: message.get_type() == "HEARTBEAT", "the drone is shown")
            yield client
    finally:
        gateway.kill()


async def eventually(read: Callable[[], Awaitable[Any]], right: Callable[[Any], bool], limit_s: float = 60) -> Any:
    """Repeat a MAVSDK call until its result is `right`, and return that."""
    value: Any = None
    async with asyncio.timeout(limit_s):
        while not right(value := await read()):
            await asyncio.sleep(0.05)
    return value


class Flight:
    """One vehicle in MAVSDK, with the status texts that it sends."""

    def __init__(self, system: Any) -> None:
        self.action, self.telemetry = ActionAsync(system), TelemetryAsync(system)
        self.texts: list[str] = []
        self._listening = asyncio.create_task(self._listen())

    async def _listen(self) -> None:
        async for text in self.telemetry.subscribe_status_text():
            self.texts.append(text.text)

    async def said(self, text: str) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while text not in self.texts:
                await asyncio.sleep(0.05)

    def close(self) -> None:
        self._listening.cancel()


async def systems(mavsdk: Mavsdk) -> dict[int, Any]:
    async with asyncio.timeout(PATIENCE_S):
        while True:
            found = {await system.get_system_id(): system for system in await mavsdk.get_systems()}
            if set(found) == {1, 2}:
                return found
            await asyncio.sleep(0.1)


class Client:
    """A pymavlink client on TCP that behaves like QGroundControl; with `beats`, it sends a heartbeat per second."""

    def __init__(self, port: int, system: int = 255) -> None:
        self.link = mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}", source_system=system, source_component=190)
        self.link.target_system, self.link.target_component = 1, 1  # else the one whose HEARTBEAT is heard first
        self.messages: list[Any] = []
        self.beats = True
        self._beat_s = 0.0
        self._asked = 0

    def pump(self) -> None:
        if self.beats and time.monotonic() >= self._beat_s:
            self._beat_s = time.monotonic() + 1
            self.link.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4)
        while (message := self.link.recv_match(blocking=False)) is not None:
            self.messages.append(message)

    def until(
        self, right: Callable[[Any], bool], what: str, limit_s: float = PATIENCE_S, since: int | None = None
    ) -> Any:
        """Wait for the first `right` message from now on, or from message number `since` on."""
        seen = len(self.messages) if since is None else since

        def came() -> bool:
            self.pump()
            return any(map(right, self.messages[seen:]))

        wait_until(came, what, limit_s)
        return next(message for message in self.messages[seen:] if right(message))

    def command(self, number: int, *params: float, drone: int = 1) -> Any:
        """Send COMMAND_LONG; returns the result of its acknowledgement, after those of its progress."""
        padded = (*params, *[NAN] * (7 - len(params)))
        self.pump()
        self._asked = len(self.messages)
        self.link.mav.command_long_send(drone, 1, number, 0, *padded)
        return self.until(lambda message: is_ack(message, number, drone), f"acknowledgement of {number}").result

    def text(self, wanted: str, limit_s: float = PATIENCE_S) -> None:
        """Wait for a text since the last command; it may have arrived with the acknowledgement."""
        self.until(
            lambda message: message.get_type() == "STATUSTEXT" and wanted in message.text, wanted, limit_s, self._asked
        )

    def close(self) -> None:
        self.link.close()


def is_ack(message: Any, number: int, drone: int) -> bool:
    is_ack = message.get_type() == "COMMAND_ACK" and message.command == number and message.get_srcSystem() == drone
    return is_ack and message.result != mavlink.MAV_RESULT_IN_PROGRESS
