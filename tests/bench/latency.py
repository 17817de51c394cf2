"""From a call of the API to the autopilot's receipt, by two brokers, an activator and a UAV client on loopback.

Beside it, in the same run and in turns with it: a message of the same length at QoS 1 through two Mosquittos that
Mosquitto's bridge joins, to a bare subscriber.
"""

from __future__ import annotations

import asyncio
import socket
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Arm, GroundStation, Word
from tests.bench.brokers import BenchBroker
from tests.bench.raw_mqtt import RawClient
from tests.integration.processes import Process, eventually, free_port

COMMANDS, COMMANDS_ON_DISK = 2000, 500
MEMORY = Path("/dev/shm")
"""Where a journal costs no wait for a disk, as in the testbed's containers."""
_ARMED = mavlink.MAVLink_heartbeat_message(2, 12, mavlink.MAV_MODE_FLAG_SAFETY_ARMED, 4 << 16, 4, 3)
_BARE_BYTES = 24
"""About a command's payload."""
_BRIDGE = """
connection fog
address 127.0.0.1:{port}
bridge_protocol_version mqttv50
notifications false
topic bare out 1
"""


class Autopilot(asyncio.DatagramProtocol):
    """One that is always armed, acknowledges each arming, and notes when it heard of it."""

    def __init__(self) -> None:
        self.heard_s: list[float] = []
        self._codec = mavlink.MAVLink(None, 1, 1)
        self._transport: Any = None

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        now_s = time.perf_counter()
        for message in mavlink.MAVLink(None).parse_buffer(data) or ():
            if message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                self.heard_s.append(now_s)
                self.send(mavlink.MAVLink_command_ack_message(message.command, 0, 0, 0, 1, 191))
                self.send(_ARMED)

    def send(self, message: Any) -> None:
        self._transport.sendto(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256

    async def live(self) -> None:
        while True:
            self.send(_ARMED)
            await asyncio.sleep(0.5)


def measure() -> list[str]:
    """Lines of figures; takes about half a minute."""
    return [
        asyncio.run(_measure(COMMANDS, "journal in memory", MEMORY)),
        asyncio.run(_measure(COMMANDS_ON_DISK, "journal on this machine's disk", None)),
    ]


async def _measure(commands: int, how: str, where: Path | None) -> str:
    with tempfile.TemporaryDirectory() as name, tempfile.TemporaryDirectory(dir=where) as journal, ExitStack() as stack:
        folder = Path(name)
        fog = _started(stack, BenchBroker(folder, "fog"))
        cloud = _started(stack, BenchBroker(folder, "cloud", _BRIDGE.format(port=fog.port)))
        port = free_port(socket.SOCK_DGRAM)
        loop = asyncio.get_running_loop()
        transport, autopilot = await loop.create_datagram_endpoint(Autopilot, remote_addr=("127.0.0.1", port))
        living = asyncio.create_task(autopilot.live())
        brokers = ["--cloud", cloud.url, "--fog-broker", fog.url]
        ready = str(folder / "activator.ready")
        activator = Process(folder, "activator", "mqttxt", "activator", "--fog", "1", *brokers, "--ready-file", ready)
        files = ["--journal", f"{journal}/journal", "--ready-file", str(folder / "uav.ready")]
        link = ["--broker", fog.url, "--autopilot", f"udp:127.0.0.1:{port}"]
        uav = Process(folder, "uav", "mqttxt", "uav", "--drone", "1", *link, *files)
        for process in (activator, uav):
            stack.callback(process.start().kill)
        for process in (activator, uav):
            await asyncio.to_thread(process.wait_ready)
        async with GroundStation(cloud.url) as station:
            (there,) = await station.connect([1])
            drone = there.drone(1)
            await eventually(lambda: drone.is_reachable, "the drone is reachable")
            ours_ms, bare_ms = await _in_turns(commands, drone, autopilot, cloud, fog)
        living.cancel()
        transport.close()
    ours, bare = _percentiles(ours_ms), _percentiles(bare_ms)
    return (
        f"latency: from a call of the API to the autopilot's receipt {ours[0]:.2f} ms (p50), {ours[1]:.2f} ms (p99), "
        f"{commands} commands, {how}; a bare QoS 1 message through the same two brokers, bridged, {bare[0]:.2f} and "
        f"{bare[1]:.2f} ms: {ours[0] / bare[0]:.1f} and {ours[1] / bare[1]:.1f} times"
    )


async def _in_turns(
    commands: int, drone: Any, autopilot: Autopilot, cloud: BenchBroker, fog: BenchBroker
) -> tuple[list[float], list[float]]:
    arrived = asyncio.Event()
    receiver = await RawClient.connect(fog.port, "bare-receiver", lambda _topic, _payload: arrived.set())
    await receiver.subscribe("bare", qos=1)
    sender = await RawClient.connect(cloud.port, "bare-sender")
    ours_ms, bare_ms = [], []
    for _ in range(commands):
        called_s = time.perf_counter()
        outcome = await drone.send(Arm())
        assert outcome.word is Word.COMPLETED, outcome
        ours_ms.append(1000 * (autopilot.heard_s[-1] - called_s))
        arrived.clear()
        called_s = time.perf_counter()
        sender.publish("bare", bytes(_BARE_BYTES), qos=1)
        await arrived.wait()
        bare_ms.append(1000 * (time.perf_counter() - called_s))
    assert len(autopilot.heard_s) == commands
    sender.close()
    receiver.close()
    return ours_ms, bare_ms


def _started(stack: ExitStack, broker: BenchBroker) -> BenchBroker:
    broker.start()
    stack.callback(broker.kill)
    return broker


def _percentiles(values: list[float]) -> tuple[float, float]:
    ranked = sorted(values)
    return ranked[len(ranked) // 2], ranked[len(ranked) * 99 // 100]
