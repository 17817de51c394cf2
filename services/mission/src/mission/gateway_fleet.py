"""The fleet over MQTT-XT with MAVSDK as the ground station, through a gateway (`mqttxt gs mavlink`) on its machine."""

from __future__ import annotations

import asyncio
import os
import sys

from .events import EventLog
from .fleet import MissionError
from .mavsdk_fleet import MavsdkFleet
from .options import Options

PORT = 14_550
STREAMS = "px4-gcs"
"""The gateway's messages are like PX4's set for a ground station, whatever the autopilots stream on their drones."""
LAST_WORDS = 300
"""How many of the last characters of the gateway's error output are kept."""


class GatewayFleet(MavsdkFleet):
    """A MavsdkFleet with the gateway in place of the routers. Raises ValueError as MavsdkFleet does."""

    def __init__(self, options: Options, log: EventLog, port: int = PORT) -> None:
        super().__init__((f"udpin://127.0.0.1:{port}",), options.fleet, options.commanding, STREAMS, log)
        self._words = gateway_command(options, port)
        self._gateway: asyncio.subprocess.Process | None = None
        self._said = b""
        self._reading: asyncio.Task[None] | None = None

    async def connect(self, limit_s: float) -> None:
        """Start the gateway and connect as MavsdkFleet. Raises MissionError also if the gateway ends."""
        self._gateway = await asyncio.create_subprocess_exec(
            *self._words, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE, env=dict(os.environ)
        )
        self._reading = asyncio.create_task(self._read(self._gateway))
        connecting = asyncio.create_task(super().connect(limit_s))
        try:
            await asyncio.wait({connecting, self._reading}, return_when=asyncio.FIRST_COMPLETED)
            self._check_gateway()
            await connecting
        finally:
            connecting.cancel()

    async def close(self) -> None:
        """Release MAVSDK, then end the gateway."""
        await super().close()
        if self._gateway is not None and self._reading is not None:
            if not self._reading.done():  # a signal to one that has just ended would take its exit code from the loop
                self._gateway.terminate()
            await self._gateway.wait()
            await self._reading

    async def changed(self) -> None:
        """As MavsdkFleet. Raises MissionError also if the gateway has ended."""
        self._check_gateway()
        await super().changed()
        self._check_gateway()

    async def _read(self, gateway: asyncio.subprocess.Process) -> None:
        """Copy the gateway's error output to stderr until it has ended."""
        assert gateway.stderr is not None
        while said := await gateway.stderr.read(4096):
            self._said = (self._said + said)[-LAST_WORDS:]
            sys.stderr.buffer.write(said)
        self._news.set()

    def _check_gateway(self) -> None:
        if self._reading is not None and self._reading.done():
            lines = self._said.decode(errors="replace").strip().splitlines()
            raise MissionError(f"the gateway has ended: {lines[-1] if lines else 'it said nothing'}")


def gateway_command(options: Options, port: int) -> list[str]:
    """The command line of `mqttxt gs mavlink` for a mission's options."""
    command = [sys.executable, "-m", "mqttxt", "gs", "mavlink", "--cloud", options.cloud, "--qos", options.qos]
    command += [word for fog in options.fleet for word in ("--fog", str(fog))]
    if options.identity is None:
        command += ["--insecure"]
    else:
        command += ["--identity", str(options.identity), *(["--signed"] if options.signed else [])]
    return [*command, "--to", f"udp:127.0.0.1:{port}"]
