"""Readings from a sensor to the ground station: nothing is lost or doubled over a stalled air link, a power loss of the
drone's computer and a restart of the activator; and a UAV client's embedded broker takes them in."""

from __future__ import annotations

import asyncio
import json
import socket
import sqlite3
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from mqttxt import GroundStation, SensorReading
from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.protocol.codec import decode
from mqttxt.protocol.readings import ReadingAck, ReadingKey
from mqttxt_conformance.tap import Tap
from tests.rigs.container import Container
from tests.rigs.flaky_link import FlakyLink
from tests.rigs.processes import ROOT, Broker, Process, System, eventually, free_port

pytestmark = [pytest.mark.integration, pytest.mark.apart]

KINDS = 3


class SensorField:
    """A drone with a broker of its own for sensors, behind a proxy to its fog, and a sensor."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.system = System(folder)
        self.cloud, self.fog, self.activator = self.system.cloud, self.system.fog, self.system.activator
        self.sitl = self.system.sitls[1]
        self.drone = Broker(folder, "drone")
        self.air = FlakyLink(self.fog.port)
        self.store = folder / "uav1.sensors"
        self.events = folder / "sensor.jsonl"
        self.uav: Process | None = None
        self.sensor: Process | None = None

    async def start(self) -> None:
        for broker in (self.cloud, self.fog, self.drone):
            await asyncio.to_thread(broker.start)
        await self.air.start()
        sensors = ["--sensor-broker", self.drone.url, "--sensor-store", str(self.store)]
        self.uav = self.system.make_uav(1, self.air.url).with_more(*sensors)
        for process in (self.sitl, self.activator, self.uav):
            process.start()
        await asyncio.to_thread(self.uav.wait_ready)

    def start_sensor(self, *more: str) -> Process:
        options = ["--broker", self.drone.url, "--number", "7", "--events", str(self.events), *more]
        self.sensor = Process(self.folder, "sensor", "sensor", *options).start()
        return self.sensor

    def measured(self) -> list[dict[str, Any]]:
        """What the sensor wrote down, complete lines only."""
        lines = self.events.read_text().split("\n")[:-1] if self.events.exists() else []
        return [json.loads(line) for line in lines]

    async def close(self) -> None:
        for process in (self.sensor, self.uav, self.activator, self.sitl):
            if process is not None:
                process.kill()
        await self.air.close()
        for broker in (self.drone, self.fog, self.cloud):
            broker.kill()


@pytest.fixture
async def field(tmp_path: Path) -> AsyncIterator[SensorField]:
    """A drone, its fog and the cloud; nobody has registered, nothing is measured yet."""
    made = SensorField(tmp_path)
    try:
        await made.start()
        yield made
    finally:
        await made.close()


async def _listen(station: GroundStation, heard: list[SensorReading]) -> None:
    async for event in station.events():
        if isinstance(event, SensorReading):
            heard.append(event)


def _as_measured(heard: list[SensorReading]) -> list[dict[str, Any]]:
    """Readings as the sensor's record has them, in its order."""
    names = ("sensor", "boot", "seq", "kind", "value", "unit", "time_ms")
    return [
        {"event": "reading", **{name: getattr(reading, name) for name in names}}
        for reading in sorted(heard, key=lambda reading: reading.seq)
    ]


async def test_nothing_is_lost_or_doubled_whatever_fails_between_sensor_and_station(field: SensorField) -> None:
    uav, heard = field.uav, []  # type: ignore[var-annotated]
    assert uav is not None
    tap = Tap(BrokerAddress.parse(field.fog.url), "listener", SessionClock())
    await tap.connect("fog")
    await tap.subscribe("drone1/sensor_ack")
    async with GroundStation(field.cloud.url) as station:
        await station.connect([1], timeout_s=60)
        listening = asyncio.create_task(_listen(station, heard))
        sensor = field.start_sensor("--rate", "40", "--samples", "500")
        await eventually(lambda: len(heard) > 150, "readings arrive")

        field.air.stall()
        at_stall = len(field.measured())
        await eventually(lambda: len(field.measured()) > at_stall + 150, "the sensor goes on while the air link stalls")
        await asyncio.to_thread(uav.kill)
        await asyncio.to_thread(field.drone.kill)
        goes_on = min(len(field.measured()) + 100, 500 * KINDS)
        await eventually(lambda: len(field.measured()) >= goes_on, "the sensor goes on without the drone")
        field.air.go_on()
        await asyncio.to_thread(field.drone.start)
        uav.start()

        before = len(heard)
        await eventually(lambda: len(heard) > before + 300, "readings arrive again")
        await asyncio.to_thread(field.activator.kill)
        field.activator.start()

        assert await asyncio.to_thread(sensor.wait, 60) == 0
        await eventually(lambda: len(heard) >= 500 * KINDS, "everything has arrived", 60)
        listening.cancel()
    measured = field.measured()
    assert len(measured) == 500 * KINDS
    assert {entry["event"] for entry in measured} == {"reading"}
    assert _as_measured(heard) == measured
    await eventually(lambda: len(_acknowledged(tap)) == 500 * KINDS, "all of it is acknowledged")
    await tap.close()
    assert await asyncio.to_thread(uav.stop) == 0
    assert _stored(field.store) == 0


async def test_readings_wait_on_the_drone_until_a_station_is_there(field: SensorField) -> None:
    sensor = field.start_sensor("--rate", "50", "--samples", "30", "--kinds", "temperature", "--json")
    assert await asyncio.to_thread(sensor.wait) == 0
    heard: list[SensorReading] = []
    async with GroundStation(field.cloud.url) as station:
        listening = asyncio.create_task(_listen(station, heard))
        await station.connect([1], timeout_s=60)
        await eventually(lambda: len(heard) == 30, "what was stored arrives")
        listening.cancel()
    assert _as_measured(heard) == field.measured()
    assert {reading.unit for reading in heard} == {"degC"}


async def test_a_uav_clients_embedded_broker_takes_readings_in(tmp_path: Path) -> None:
    field = SensorField(tmp_path)
    port, autopilot = free_port(), field.system.autopilots[1]
    uav = Container(tmp_path / "contained-uav.log")
    try:
        await asyncio.to_thread(field.cloud.start)
        await asyncio.to_thread(field.fog.start)
        field.sitl.start()
        field.activator.start()
        _run(uav, field.fog.url, autopilot, f"127.0.0.1:{port}")
        heard: list[SensorReading] = []
        async with GroundStation(field.cloud.url) as station:
            (fog,) = await station.connect([1], timeout_s=60)
            await eventually(lambda: fog.drone(1).is_reachable, "the drone is reachable", 60)
            listening = asyncio.create_task(_listen(station, heard))
            events = ["--events", str(field.events), "--rate", "20", "--samples", "20"]
            sensor = Process(tmp_path, "sensor", "sensor", "--broker", f"mqtt://127.0.0.1:{port}", *events).start()
            assert await asyncio.to_thread(sensor.wait) == 0, uav.said()
            await eventually(lambda: len(heard) == 20 * KINDS, "every reading")
            listening.cancel()
        assert _as_measured(heard) == field.measured()
    finally:
        for process in (uav, field.activator, field.sitl):
            process.kill()
        for broker in (field.fog, field.cloud):
            broker.kill()


async def test_a_port_for_sensors_that_is_taken_is_one_line_and_keeps_no_drone_without_its_client(
    tmp_path: Path,
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        uav = Container(tmp_path / "contained-uav.log")
        try:
            _run(uav, "mqtt://127.0.0.1:1", free_port(socket.SOCK_DGRAM), address)
            said = f"--sensors {address}: Address already in use; the broker starts once it can listen there"
            await eventually(lambda: said in uav.said(), "the line")
            assert await asyncio.to_thread(uav.ended) is None
        finally:
            uav.kill()


def _run(uav: Container, fog: str, autopilot_port: int, sensors: str) -> None:
    """`mqttxt uav` with its embedded broker, from the testbed's image but with the code as it is here."""
    options = ["--drone", "1", "--broker", fog, "--autopilot", f"udp:127.0.0.1:{autopilot_port}"]
    files = ["--journal", "/tmp/uav1.journal", "--sensor-store", "/tmp/uav1.sensors"]
    volumes = {str(ROOT / "services"): {"bind": "/opt/services", "mode": "ro"}}
    uav.run(["mqttxt", "uav", *options, *files, "--sensors", sensors], init=True, volumes=volumes)


def _acknowledged(tap: Tap) -> set[ReadingKey]:
    """What the activator has passed on, by what it told the drone."""
    return {key for heard in tap.heard for key in decode(ReadingAck, heard.payload).readings}


def _stored(path: Path) -> int:
    database = sqlite3.connect(path)
    try:
        (count,) = database.execute("SELECT count(*) FROM reading").fetchone()
    finally:
        database.close()
    return int(count)
