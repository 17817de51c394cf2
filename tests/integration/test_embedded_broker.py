"""The activator supervises its embedded Mosquitto: it comes back when it dies, and a taken port is one line."""

from __future__ import annotations

import asyncio
import shlex
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from mqttxt import Arm, Fog, GroundStation, Takeoff, Word
from mqttxt.core import mosquitto
from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.core.effects import Publish, Subscribe
from mqttxt.core.mqtt import connection
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.core.mqtt.properties import MOST_IN_FLIGHT
from mqttxt.protocol.codec import decode
from mqttxt.protocol.messages import FogPresence
from mqttxt_conformance.tap import Tap
from tests.rigs.commanding import follow
from tests.rigs.container import Container
from tests.rigs.linked import Heard
from tests.rigs.processes import Broker, System, as_this_user, eventually, free_port, wait_until

pytestmark = [pytest.mark.integration, pytest.mark.apart]

KILL_MOSQUITTO = """
import os, pathlib, signal, socket, sys
while socket.socket().connect_ex(('127.0.0.1', int(sys.argv[1]))):
    pass
for found in pathlib.Path('/proc').glob('[0-9]*/comm'):
    if found.read_text().strip() == 'mosquitto':
        os.kill(int(found.parent.name), signal.SIGKILL)
        print('killed')
"""


class ContainedActivator(Container):
    """`mqttxt activator` with its embedded broker, from the testbed's image, on loopback."""

    def __init__(self, folder: Path, cloud: str, port: int) -> None:
        super().__init__(folder / "activator.log")
        self.port = port
        options = ["--fog", "1", "--cloud", cloud, "--listen", f"127.0.0.1:{port}", "--drones", "1,2"]
        self._command = ["mqttxt", "activator", *options]
        self._killer = ["python3", "-c", KILL_MOSQUITTO, str(port)]

    def start(self) -> None:
        self.run(self._command, init=True)

    def start_and_lose_the_first_broker(self) -> None:
        """The first Mosquitto is killed as soon as it listens."""
        both = f"{shlex.join(self._killer)} & exec {shlex.join(self._command)}"
        self.run(["sh", "-c", both], init=True)

    def kill_broker(self) -> None:
        assert self.execute(self._killer, user="1000:1000") == (0, b"killed\n")


async def broker_in_the_birth(cloud: str) -> str | None:
    """The address that fog 1's activator tells of its broker."""
    tap = Tap(BrokerAddress.parse(cloud), "witness", SessionClock())
    await tap.connect("--cloud")
    await tap.subscribe("fog1/reachable")
    (birth,) = await tap.until(lambda: tap.heard, 5)
    await tap.close()
    return decode(FogPresence, birth.payload).broker


@asynccontextmanager
async def reached(
    system: System, contained: ContainedActivator, start: Callable[[ContainedActivator], None]
) -> AsyncIterator[Fog]:
    """The fog of an activator that is started so, once a station reaches both drones there."""
    system.uavs = {n: system.make_uav(n, f"mqtt://127.0.0.1:{contained.port}") for n in system.autopilots}
    try:
        system.cloud.start()
        start(contained)
        for process in (*system.sitls.values(), *system.uavs.values()):
            process.start()
        async with GroundStation(system.cloud.url) as station:
            (fog,) = await station.connect([1], timeout_s=60)
            await eventually(lambda: all(fog.drone(n).is_reachable for n in (1, 2)), "both drones reachable")
            yield fog
    finally:
        contained.kill()
        system.close()


async def test_a_killed_embedded_broker_comes_back_in_mid_flight(tmp_path: Path) -> None:
    system = System(tmp_path)
    contained = ContainedActivator(tmp_path, system.cloud.url, free_port())
    async with reached(system, contained, ContainedActivator.start) as fog:
        assert (await fog.broadcast(Arm())).completed
        heard, listening = follow(fog.broadcast(Takeoff(8)))
        await eventually(lambda: len(heard) == 2, "takeoff accepted")
        await asyncio.to_thread(contained.kill_broker)
        async with asyncio.timeout(60):
            await listening
        assert await broker_in_the_birth(system.cloud.url) == f"mqtt://127.0.0.1:{contained.port}"
        await eventually(lambda: "embedded broker ended with code" in contained.said(), "its end is told")
        assert sorted((o.drone, o.word) for o in heard if o.is_last) == [(1, Word.COMPLETED), (2, Word.COMPLETED)]
        assert [len(system.commanded(n, 22)) for n in (1, 2)] == [1, 1]


async def test_an_embedded_broker_that_dies_as_soon_as_it_listens_comes_back(tmp_path: Path) -> None:
    system = System(tmp_path)
    contained = ContainedActivator(tmp_path, system.cloud.url, free_port())
    async with reached(system, contained, ContainedActivator.start_and_lose_the_first_broker) as fog:
        outcomes = await fog.broadcast(Arm())
        assert [outcome.word for outcome in outcomes] == [Word.COMPLETED, Word.COMPLETED]
        assert contained.said().count("embedded broker ended with code -9") == 1


async def test_an_activator_may_give_each_topic_of_its_drones_an_alias(tmp_path: Path) -> None:
    """Mosquitto takes `max_topic_alias` for the listener before it."""
    broker = Broker(tmp_path, "cloud")
    broker.configuration.write_text(mosquitto.configuration("127.0.0.1", broker.port))
    broker.start()
    try:
        tap = Tap(BrokerAddress.parse(broker.url), "tap", SessionClock())
        await tap.connect("--broker")
        assert tap.connack.TopicAliasMaximum == 4096
        await tap.close()
    finally:
        broker.kill()


async def test_a_broker_that_dropped_acknowledgements_carries_commands_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mosquitto drops each packet for a client that 1,000 wait for, as behind an activator that stood still."""
    monkeypatch.setattr(connection, "_MISC_S", 0.05)
    broker = Broker(tmp_path, "fog")
    broker.configuration.write_text(as_this_user() + mosquitto.configuration("127.0.0.1", broker.port))
    broker.start()
    loop, activator, drones = asyncio.get_running_loop(), Heard(), Heard()
    made = {
        name: MqttLink("fog", BrokerAddress.parse(broker.url), name, None, heard)
        for name, heard in (("activator", activator), ("drones", drones))
    }
    running = [asyncio.create_task(link.run()) for link in made.values()]
    try:
        await eventually(lambda: (activator.connections, drones.connections) == (1, 1), "connected")
        made["activator"].subscribe(Subscribe("fog", ("+/states",)))
        await eventually(lambda: activator.subscribes != [], "subscribed")
        behind = made["activator"]._connection
        assert isinstance(behind, connection.Connection)
        sock = behind._socket
        assert sock is not None
        loop.remove_reader(sock)
        made["drones"].subscribe(Subscribe("fog", ("+/init_connect", "+/commands")))
        for _ in range(4000):
            made["drones"].publish(Publish("fog", "drone1/states", bytes(2000)))
        await eventually(lambda: "are being dropped for client activator" in broker.said(), "more than it keeps")
        for drone in range(1, 251):
            made["activator"].publish(Publish("fog", f"drone{drone}/init_connect", b"lease", qos=1))
        await eventually(lambda: len(drones.messages) == MOST_IN_FLIGHT, "leases")
        loop.add_reader(sock, behind._incoming.readable)
        await eventually(lambda: activator.connections == 2, "connected anew")
        made["activator"].publish(Publish("fog", "drone1/commands", b"hold", qos=1, ref="hold"))
        await eventually(lambda: activator.acknowledged == [("hold", 0)], "acknowledged")
        await eventually(lambda: drones.messages[-1].payload == b"hold", "the command")
    finally:
        for task in running:
            task.cancel()
        await asyncio.wait(running)
        broker.kill()


def test_a_port_in_use_is_one_line(tmp_path: Path) -> None:
    system = System(tmp_path)
    system.cloud.start()
    contained = ContainedActivator(tmp_path, system.cloud.url, system.cloud.port)
    try:
        contained.start()
        wait_until(lambda: contained.ended() is not None, "the activator gives up")
        assert contained.ended() == 2
        (said,) = [line for line in contained.said().splitlines() if line.startswith("mqttxt: ")]
        assert f"--listen 127.0.0.1:{system.cloud.port}: another program listens there" in said
        assert "Traceback" not in contained.said()
    finally:
        contained.kill()
        system.close()
