"""The sensors' side of a UAV client: the store works beside the event loop, and whatever it does the drone flies on."""

from __future__ import annotations

import asyncio
import contextlib
import sqlite3
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from mqttxt.cli.main import app
from mqttxt.cli.watch import everything
from mqttxt.core.address import BrokerAddress
from mqttxt.core.channel import Channel
from mqttxt.core.effects import Inbound, Log, Publish
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import ForgetReadings, Journal, StoreReading
from mqttxt.drone.sensors import port as sensors
from mqttxt.drone.sensors.carrier import Carrier
from mqttxt.drone.sensors.port import Receipts, SensorOptions, SensorPort
from mqttxt.errors import BrokerRefused, ConfigurationError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.readings import ReadingAck
from mqttxt.protocol.topics import FogSide
from mqttxt.station.ground_station import GroundStation
from tests.rigs.processes import eventually
from tests.simulation.carrying import inbound, reading

NOWHERE = BrokerAddress.parse("mqtt://127.0.0.1:1")


class PortBench:
    """A port with a store and no broker; what it cannot do itself is noted."""

    def __init__(self, path: Path, limit: int = 100) -> None:
        self.carrier = Carrier(1, Channel("fog", "", Settings()), FogSide())
        self.out: list[Any] = []
        self.acknowledged: list[Any] = []
        events: Any = None
        self.port = SensorPort(SensorOptions(NOWHERE, path, limit), self.carrier, 1, events, self.carry_out, lambda: 0)
        self.port._receipts = Receipts(self.acknowledged.append)

    def carry_out(self, effects: Any) -> None:
        for effect in effects:
            self.port.does.get(type(effect), self.out.append)(effect)

    def receive(self, seq: int, receipt: tuple[int, int] | None = None) -> None:
        self.carry_out(self.carrier.on_message(inbound(reading(seq), receipt), 0))

    def safe(self) -> list[int]:
        """What sensors were told to be stored."""
        acks = [e for e in self.out if isinstance(e, Publish) and e.topic == "sensor_ack"]
        return [key.seq for ack in acks for key in decode(ReadingAck, ack.payload).readings]


@contextlib.asynccontextmanager
async def working(bench: PortBench) -> AsyncIterator[PortBench]:
    task = asyncio.create_task(bench.port._work())
    try:
        yield bench
    finally:
        task.cancel()
        await asyncio.wait([task])


async def test_readings_are_stored_beside_the_loop_and_then_acknowledged_in_order(tmp_path: Path) -> None:
    async with working(PortBench(tmp_path / "store")) as bench:
        for seq in range(20):
            bench.receive(seq, (1, seq))
        bench.carry_out(bench.carrier.on_message(Inbound("sensor1/temperature", b"bad", 1, False, (1, 20)), 0))
        assert bench.acknowledged == []  # the malformed one waits for its turn
        await eventually(lambda: len(bench.acknowledged) == 21, "all are acknowledged")
        assert bench.acknowledged == [(1, n) for n in range(21)]
        assert bench.safe() == list(range(20))


async def test_a_full_store_takes_in_again_what_has_room_after_an_acknowledgement(tmp_path: Path) -> None:
    async with working(PortBench(tmp_path / "store", limit=1)) as bench:
        bench.receive(0)
        bench.receive(1)
        await eventually(lambda: any(isinstance(e, Log) for e in bench.out), "one is refused")
        assert bench.safe() == [0]
        bench.carry_out([ForgetReadings((reading(0).key,))])
        bench.receive(1)
        await eventually(lambda: bench.safe() == [0, 1], "the other is stored too")


async def test_after_an_error_of_the_disk_it_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensors, "PAUSE_S", 0.0)
    async with working(PortBench(tmp_path / "store")) as bench:
        bench.receive(0)
        await eventually(lambda: bench.safe() == [0], "the first is stored")
        store = bench.port._store
        healthy = store._database
        store._database = Broken()  # type: ignore[assignment]
        bench.carry_out(bench.carrier.on_fog_up(0))
        bench.carry_out([ForgetReadings((reading(0).key,))])
        bench.receive(1)
        await eventually(
            lambda: any(isinstance(e, Log) and "disk I/O error" in e.detail for e in bench.out), "the error is told"
        )
        assert bench.safe() == [0]
        store._database = healthy
        bench.receive(1)
        await eventually(lambda: bench.safe() == [0, 1], "the second is stored")
        await eventually(
            lambda: [e.topic for e in bench.out if getattr(e, "link", "") == "fog"] != [], "what waits is sent"
        )
        assert len(store) == 1  # what was to be forgotten meanwhile is forgotten


class Broken:
    """A database whose disk answers nothing but errors."""

    in_transaction = True

    def execute(self, *_: Any) -> None:
        raise sqlite3.OperationalError("disk I/O error")

    def close(self) -> None:
        """Nothing is open."""


async def test_a_refused_connection_ends_the_sensors_side_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    bench = PortBench(tmp_path / "store")

    async def refused() -> None:
        raise BrokerRefused("sensors: mqtt://127.0.0.1:1: another client took over the id mqttxt-drone1-sensors")

    monkeypatch.setattr(bench.port.link, "run", refused)
    await bench.port._keep_link()
    assert "no reading is taken in until this UAV client is started again" in caplog.text


async def test_the_drones_broker_waits_for_its_address(tmp_path: Path) -> None:
    class Embedded:
        waits = False

        async def run(self, waits: bool = False) -> None:
            self.waits = waits

    bench, embedded = PortBench(tmp_path / "store"), Embedded()
    bench.port._embedded = embedded  # type: ignore[assignment]
    first, *others = bench.port.jobs()
    for job in others:
        job.close()
    await first
    assert embedded.waits


def test_receipts_that_become_safe_out_of_order_wait_for_those_before_them() -> None:
    done: list[Any] = []
    receipts = Receipts(done.append)
    for n in range(3):
        receipts.wait((1, n))
    receipts.release((1, 1))
    assert done == []
    receipts.release((1, 0))
    assert done == [(1, 0), (1, 1)]
    receipts.release((1, 2))
    receipts.release((2, 0))
    assert done == [(1, 0), (1, 1), (1, 2), (2, 0)]


def test_other_effects_are_not_the_ports(tmp_path: Path) -> None:
    assert Journal not in PortBench(tmp_path / "store").port.does


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--sensors", "1883"], "--sensors '1883': expected HOST:PORT"),
        (["--sensors", "0.0.0.0:99999"], "--sensors '0.0.0.0:99999': expected HOST:PORT"),
        (["--sensors", "0.0.0.0:1883", "--sensor-broker", "mqtt://x"], "--sensor-broker 'mqtt://x': expected no"),
        (["--sensor-broker", "x"], "--sensor-broker 'x': expected"),
        (
            ["--sensor-broker", "mqtt://127.0.0.1", "--sensor-store-limit", "0"],
            "--sensor-store-limit 0: expected 1 or more",
        ),
        (
            ["--sensor-broker", "mqtt://127.0.0.1", "--sensor-store", "/dev/null/x"],
            "--sensor-store /dev/null/x: cannot be used",
        ),
    ],
)
def test_a_bad_value_of_the_uav_client_is_one_line(options: list[str], said: str, tmp_path: Path) -> None:
    common = ["uav", "--drone", "1", "--broker", "mqtt://127.0.0.1:1", "--journal", str(tmp_path / "journal")]
    done = CliRunner().invoke(app, [*common, "--autopilot", "udp:127.0.0.1:65535", *options])
    assert done.exit_code == ConfigurationError.exit_code
    (line,) = done.stderr.splitlines()
    assert said in line


def test_the_reading_that_the_documentation_publishes_is_one() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "uav-client.md").read_text(encoding="utf-8")
    command = page.split("mosquitto_pub ")[1]
    topic, payload = command.split("-t ")[1].split()[0], command.split("-m '")[1].split("'")[0]
    carrier = Carrier(1, Channel("fog", "", Settings()), FogSide())
    (store,) = carrier.on_message(Inbound(topic, payload.encode(), 1), 0)
    assert isinstance(store, StoreReading)
    assert (store.reading.kind, store.reading.message.value, store.reading.unit) == ("temperature", 21.5, "degC")


def test_the_newest_readings_are_watched(capsys: pytest.CaptureFixture[str]) -> None:
    async def check() -> None:
        gs = GroundStation("mqtt://127.0.0.1:1")
        inside = gs._runner
        inside.carry_out(inside.station.add_fogs([1]))
        for seq, kind, unit in ((0, "temperature", None), (1, "temperature", None), (2, "wind", "[m/s]")):
            message = reading(seq, kind=kind, unit=unit, value=seq + 0.5).message
            inside.received("cloud", Inbound(f"fog1/drone2/sensor3/{kind}", encode(message), 1))
        fog = gs.fog(1)
        assert [(r.kind, r.value) for r in fog.drone(2).readings] == [("temperature", 1.5), ("wind", 2.5)]
        fog._view.configured = (2,)
        Console(width=140).print(everything([fog]))

    asyncio.run(check())
    shown = capsys.readouterr().out
    assert "1.5 degC" in shown
    assert "2.5 [m/s]" in shown
    assert "2026-01-01 00:00:00" in shown
