"""The time from an API call to the autopilot's receipt: MQTT-XT, and MAVSDK through three mavp2p routers, on loopback.

The way of both is station, cloud, fog, UAV, autopilot. MQTT-XT has a broker at the cloud, an activator and a broker at
the fog and a UAV client; MAVLink has a router at each. In turns with them, in the same run: a QoS 1 message of a
command's length through the same two Mosquittos, joined by Mosquitto's bridge, to a bare subscriber.
"""

from __future__ import annotations

import asyncio
import socket
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.logging import LogLevel, log_subscribe

from tests.bench.always_armed import AlwaysArmed
from tests.bench.armed_drone import ArmedDrone
from tests.bench.raw_mqtt import RawClient
from tests.rigs.processes import free_port
from tests.rigs.routers import chain

COMMANDS, COMMANDS_ON_DISK = 2000, 500
WARM_UP = 20
"""Turns before the measured ones."""
ROUTERS = 3
MEMORY = Path("/dev/shm")
"""A folder where a journal does not wait for a disk, as in the testbed's containers."""
_BARE_BYTES = 24
"""About a command's payload."""
_BRIDGE = """
connection fog
address 127.0.0.1:{port}
bridge_protocol_version mqttv50
notifications false
topic bare out 1
"""

Turn = Callable[[], Awaitable[float]]
"""Sends one command and awaits its acknowledgement; returns the milliseconds from the call to the receipt."""


@dataclass(frozen=True)
class Percentiles:
    """Percentiles of many turns, in milliseconds."""

    p50: float
    p99: float

    @classmethod
    def of(cls, values: list[float]) -> Percentiles:
        ranked = sorted(values)
        return cls(ranked[len(ranked) // 2], ranked[len(ranked) * 99 // 100])

    def __str__(self) -> str:
        return f"{self.p50:.2f} ms (p50), {self.p99:.2f} ms (p99)"


def measure() -> list[str]:
    """Lines of figures; takes about half a minute."""
    log_subscribe(lambda level, *_: bool(level < LogLevel.WARN))  # True: not on the terminal, where figures are
    return [
        asyncio.run(_measure(COMMANDS, "journal in memory", MEMORY)),
        asyncio.run(_measure(COMMANDS_ON_DISK, "journal on this machine's disk", None)),
    ]


async def _measure(commands: int, how: str, where: Path | None) -> str:
    async with AsyncExitStack() as stack:
        over_mqttxt, bare = await stack.enter_async_context(_mqttxt(where))
        over_mavlink, autopilot = await stack.enter_async_context(_mavlink())
        sides = (over_mqttxt, bare, over_mavlink)
        found: tuple[list[float], ...] = ([], [], [])
        for turn in range(WARM_UP + commands):
            for side, times_ms in zip(sides, found, strict=True):
                times_ms.append(await side())
            if turn + 1 == WARM_UP:
                for times_ms in found:
                    times_ms.clear()
                autopilot.kinds.clear()
        asked = sum(count for kind, count in autopilot.kinds.items() if kind.startswith("COMMAND_"))
    ours, plain, theirs = (Percentiles.of(times_ms) for times_ms in found)
    return (
        f"latency: {commands} calls, {how}: from a call of the API to the autopilot's receipt {ours}; MAVSDK through "
        f"{ROUTERS} routers {theirs}, {asked / commands:g} COMMAND_LONG a call: MQTT-XT takes "
        f"{ours.p50 / theirs.p50:.1f} and {ours.p99 / theirs.p99:.1f} times as long; a bare QoS 1 message through the "
        f"same two brokers, bridged, {plain}: {ours.p50 / plain.p50:.1f} and {ours.p99 / plain.p99:.1f} times"
    )


@asynccontextmanager
async def _mqttxt(journals: Path | None) -> AsyncIterator[tuple[Turn, Turn]]:
    """An arming over MQTT-XT, and the bare message through its brokers."""
    with tempfile.TemporaryDirectory() as name, tempfile.TemporaryDirectory(dir=journals) as journal, ExitStack() as on:
        system = ArmedDrone(Path(name), Path(journal))
        with system.cloud.configuration.open("a") as configuration:
            configuration.write(_BRIDGE.format(port=system.fog.port))
        async with system.flying() as (_, drone):

            async def arm() -> None:
                outcome = await drone.arm()
                assert outcome.completed, outcome

            bare = await _bare(on, system.cloud.port, system.fog.port)
            yield lambda: _until_heard(arm, system.autopilot), bare


async def _bare(on: ExitStack, cloud_port: int, fog_port: int) -> Turn:
    arrived = asyncio.Event()
    receiver = await RawClient.connect(fog_port, "bare-receiver", lambda _topic, _payload: arrived.set())
    on.callback(receiver.close)
    await receiver.subscribe("bare", qos=1)
    sender = await RawClient.connect(cloud_port, "bare-sender")
    on.callback(sender.close)

    async def turn() -> float:
        arrived.clear()
        called_ns = time.time_ns()
        sender.publish("bare", bytes(_BARE_BYTES), qos=1)
        await arrived.wait()
        return (time.time_ns() - called_ns) / 1e6

    return turn


@asynccontextmanager
async def _mavlink() -> AsyncIterator[tuple[Turn, AlwaysArmed]]:
    """An arming by MAVSDK through a chain of routers."""
    ports = [free_port(socket.SOCK_DGRAM) for _ in range(ROUTERS + 1)]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as on:
        for router in chain(Path(folder), ports):
            on.callback(router.start().kill)
        autopilot = AlwaysArmed(ports[0])
        on.callback(autopilot.close)
        mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        on.callback(mavsdk.destroy)
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{ports[-1]}")
        system = await mavsdk.first_autopilot(timeout_s=10)
        assert system is not None, "MAVSDK saw no autopilot through the routers"
        action = ActionAsync(system)
        yield lambda: _until_heard(action.arm, autopilot), autopilot


async def _until_heard(arm: Callable[[], Awaitable[Any]], autopilot: AlwaysArmed) -> float:
    before = len(autopilot.heard_ns)
    called_ns = time.time_ns()
    await arm()
    assert len(autopilot.heard_ns) == before + 1, "one call, one arming: a repetition would falsify the figure"
    return (autopilot.heard_ns[-1] - called_ns) / 1e6
