"""Scenario 4, which has all steps, over both fleets: real stand-ins, sensors, clients and brokers; points nearby."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any, Self

import docker
import pytest
import yaml

from mission import flight, scenarios
from mission.events import EventLog
from mission.fleet import Fleet, Point
from mission.mavsdk_fleet import MavsdkFleet
from mission.mqttxt_fleet import MqttxtFleet
from mission.options import Options
from mission.points import all_points
from mqttxt.protocol.commands import haversine_m
from mqttxt.protocol.readings import UNITS
from testbed.bootstrap.images import NODE
from tests.quick import FLYING, quick_fleet
from tests.rigs.processes import ROOT, Broker, Process, System, eventually, free_port, stand_in, wait_until

pytestmark = [pytest.mark.integration, pytest.mark.apart]
MISSIONS = pytest.mark.soak("services/mission/src", "services/sensor/src")
DRONES = (1, 2)
LOW_M = 3.0
SAMPLES = 3
STEPS = [(name, True) for name in ("arm", "takeoff", "goto", "collect", "return", "disarmed")]
SHARE = 0.12
"""How much of the way to a point is flown."""


@pytest.fixture
def low_fleet(tmp_path: Path) -> Path:
    """The fleet with quick drones, which return at the height that is flown here."""
    return quick_fleet(tmp_path, FLYING | {"RTL_RETURN_ALT": LOW_M})


@pytest.fixture
def near(monkeypatch: pytest.MonkeyPatch, low_fleet: Path) -> dict[int, Point]:
    """Points on the way to the drones' own."""
    homes = yaml.safe_load(low_fleet.read_text())["drones"]
    found = {}
    for drone in DRONES:
        home, point = homes[drone], all_points()[drone]
        latitude, longitude = (
            home[name] + (getattr(point, name) - home[name]) * SHARE for name in ("latitude_deg", "longitude_deg")
        )
        found[drone] = replace(point, latitude_deg=latitude, longitude_deg=longitude, altitude_m=LOW_M)
    monkeypatch.setattr(scenarios, "points_of", lambda drones: {drone: found[drone] for drone in drones})
    monkeypatch.setattr(scenarios, "ALTITUDE_M", LOW_M)
    return found


@pytest.fixture
def autopilots(tmp_path: Path, low_fleet: Path) -> Iterator[dict[int, int]]:
    """Stand-ins that send to a port each."""
    ports = {drone: free_port(socket.SOCK_DGRAM) for drone in DRONES}
    sitls = [stand_in(tmp_path, drone, port, fleet=low_fleet) for drone, port in ports.items()]
    try:
        for sitl in sitls:
            sitl.start()
        for sitl in sitls:
            sitl.wait_ready()
        yield ports
    finally:
        for sitl in sitls:
            sitl.kill()


class SensorSystem(System):
    """Two drones on one fog, each with a broker of its own for sensors."""

    def __init__(self, folder: Path, fleet_file: Path) -> None:
        super().__init__(folder, fleet_file=fleet_file)
        self.drones = {drone: Broker(folder, f"drone{drone}") for drone in self.autopilots}
        for drone, broker in self.drones.items():
            carrying = ["--sensor-broker", broker.url, "--sensor-store", str(folder / f"uav{drone}.sensors")]
            self.uavs[drone] = self.make_uav(drone, self.fog.url).with_more(*carrying)

    def start(self) -> Self:
        for broker in self.drones.values():
            broker.start()
        return super().start()

    def close(self) -> None:
        super().close()
        for broker in self.drones.values():
            broker.kill()


@pytest.fixture
def system(tmp_path: Path, low_fleet: Path) -> Iterator[SensorSystem]:
    with closing(SensorSystem(tmp_path, low_fleet)) as made:
        yield made.start()


class Sensors:
    """A sensor for each drone, which measures once the mission has begun: before that it is out of reach."""

    def __init__(self, folder: Path, brokers: dict[int, str], *more: str) -> None:
        self.folder = folder / "sensors"
        self.folder.mkdir()
        self._started = folder / "start"
        self._sensors = []
        for drone, broker in brokers.items():
            events = ["--events", str(self.folder / f"sensor{drone}.jsonl"), "--number", str(drone)]
            options = [
                "--broker",
                broker,
                "--samples",
                str(SAMPLES),
                "--when-reached",
                "--stay",
                "--insecure",
                *events,
                *more,
            ]
            self._sensors.append(Process(folder, f"sensor{drone}", "sensor", *options))

    async def come_into_reach(self) -> None:
        await eventually(self._started.exists, "the mission has begun", 90)
        for sensor in self._sensors:
            sensor.start()

    def close(self) -> None:
        for sensor in self._sensors:
            sensor.kill()


class PlainChain:
    """A plain broker on the cloud, a fog and each UAV, as beside MAVLink; each container has an address of its own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._running: dict[str, Any] = {}
        self.cloud = ""
        self.uavs: dict[int, str] = {}

    def start(self) -> None:
        self.cloud = self._start("cloud", "mosquitto", "-c", "/opt/services/broker/mosquitto.conf")
        fog = self._bridge("fog1", self.cloud)
        self.uavs = {drone: f"mqtt://{self._bridge(f'drone{drone}', fog)}" for drone in DRONES}

    def close(self) -> None:
        for name, container in self._running.items():
            (self._folder / f"{name}.log").write_bytes(container.logs())
            container.remove(force=True)

    def _bridge(self, name: str, host: str) -> str:
        return self._start(name, "/opt/services/broker/bridge", name, host)

    def _start(self, name: str, program: str, *arguments: str) -> str:
        volumes = {str(ROOT / "services"): {"bind": "/opt/services", "mode": "ro"}}
        run = docker.from_env().containers.run
        container = run(NODE, list(arguments), entrypoint=program, detach=True, volumes=volumes)
        self._running[name] = container
        container.reload()
        (network,) = container.attrs["NetworkSettings"]["Networks"].values()
        wait_until(lambda: _listens(network["IPAddress"]), f"{name}'s broker runs")
        return str(network["IPAddress"])


def _listens(host: str) -> bool:
    with socket.socket() as sock:
        sock.settimeout(1)
        return sock.connect_ex((host, 1883)) == 0


def _options(folder: Path, protocol: str, sensors: Sensors) -> Options:
    """Scenario 4, as far as the flight itself looks at its options."""
    return Options(
        *("scenario-4", protocol, {1: DRONES}, "", "1", "on-change", (), "px4-onboard", "one-by-one", SAMPLES),
        sensors=sensors.folder,
        series=folder / "series.json",
        links_start=folder / "start",
    )


async def _fly(options: Options, fleet: Fleet, log: EventLog, sensors: Sensors) -> list[tuple[str, bool]]:
    """Fly a mission to its end; returns its steps."""
    reaching = asyncio.create_task(sensors.come_into_reach())
    try:
        assert await flight.fly(options, scenarios.scenario_4, fleet, log) is None
    finally:
        reaching.cancel()
        sensors.close()
        log.close()
    return [(event["name"], event["ok"]) for event in _events(options) if event["event"] == "step_done"]


def _events(options: Options) -> list[dict[str, Any]]:
    assert options.series is not None
    return _lines(options.series.with_name("events.jsonl"))


def _lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def _assert_flown(folder: Path, drone: int, point: Point) -> None:
    """An autopilot's own record: it was near its point, and is on the ground where it took off."""
    positions = [event for event in _lines(folder / f"sitl{drone}.jsonl") if event["event"] == "position"]
    places = [(event["latitude_deg"], event["longitude_deg"]) for event in positions]
    assert min(haversine_m(*place, point.latitude_deg, point.longitude_deg) for place in places) < 5
    assert haversine_m(*places[0], *places[-1]) < 2
    happened = [event["event"] for event in _lines(folder / f"sitl{drone}.jsonl")]
    assert [event for event in happened if event in ("armed", "took_off", "landed", "disarmed")] == [
        *("armed", "took_off", "landed", "disarmed")
    ]
    assert [event["mode"] for event in _lines(folder / f"sitl{drone}.jsonl") if event["event"] == "mode"] == [
        *("takeoff", "hold", "return", "hold")
    ]


def _assert_collected(folder: Path, options: Options) -> None:
    """Every series is whole: each value was heard once, after it was measured."""
    series = json.loads((folder / "series.json").read_text())["series"]
    assert [(one["drone"], one["kind"], one["unit"], one["delivered"], one["whole"]) for one in series] == [
        (drone, kind, unit, SAMPLES, True) for drone in DRONES for kind, unit in UNITS.items()
    ]
    heard = [event for event in _events(options) if event["event"] == "reading"]
    assert len(heard) == len(series) * SAMPLES
    assert all(event["t_ns"] / 1e6 >= event["time_ms"] for event in heard)


@MISSIONS
async def test_scenario_4_over_mavlink_with_plain_brokers_beside_it(
    tmp_path: Path, autopilots: dict[int, int], near: dict[int, Point]
) -> None:
    log = EventLog(tmp_path / "events.jsonl", StringIO())
    chain = PlainChain(tmp_path)
    try:
        await asyncio.to_thread(chain.start)
        sensors = Sensors(tmp_path, chain.uavs, "--plain")
        urls = tuple(f"udpin://127.0.0.1:{port}" for port in autopilots.values())
        fleet = MavsdkFleet(urls, {1: DRONES}, "one-by-one", "px4-onboard", log, f"mqtt://{chain.cloud}")
        options = _options(tmp_path, "mavlink", sensors)
        assert await _fly(options, fleet, log, sensors) == STEPS
    finally:
        chain.close()
    _assert_collected(tmp_path, options)
    for drone, point in near.items():
        _assert_flown(tmp_path, drone, point)
        words = [event["word"] for event in _events(options) if event.get("drone") == drone and "word" in event]
        assert words == ["accepted", "completed"] * 4


async def test_scenario_4_over_mqttxt(tmp_path: Path, system: SensorSystem, near: dict[int, Point]) -> None:
    log = EventLog(tmp_path / "events.jsonl", StringIO())
    sensors = Sensors(tmp_path, {drone: broker.url for drone, broker in system.drones.items()})
    fleet = MqttxtFleet(system.cloud.url, {1: DRONES}, 1, log)
    options = _options(tmp_path, "mqttxt", sensors)
    assert await _fly(options, fleet, log, sensors) == STEPS
    _assert_collected(tmp_path, options)
    for drone, point in near.items():
        _assert_flown(tmp_path, drone, point)
    commands = [(event["command"], event["drone"]) for event in _events(options) if event["event"] == "command"]
    assert commands == [("arm", None), ("takeoff", None), ("goto", 1), ("goto", 2), ("return", None)]


@MISSIONS
async def test_the_pages_own_mission_flies(tmp_path: Path, low_fleet: Path) -> None:
    """The program of docs/own-missions.md as it stands, on the drones of one fog."""
    page = (ROOT / "docs" / "own-missions.md").read_text()
    program = tmp_path / "search.py"
    program.write_text(page.split("```python\n")[1].split("```")[0])
    system = System(tmp_path, fleet_file=low_fleet)
    for drone in DRONES:
        system.uavs[drone] = system.make_uav(drone, system.fog.url).with_more("--endurance-s", "700")
    where = ["--fleet", "1:1,2", "--cloud", system.cloud.url, "--events", str(tmp_path / "events.jsonl")]
    flying = Process(tmp_path, "mission", "mission", "fly", str(program), *where)
    try:
        system.start()
        assert await asyncio.to_thread(flying.start().wait, 110) == 0, flying.log.read_text()
    finally:
        flying.kill()
        system.close()
    events = _lines(tmp_path / "events.jsonl")
    steps = [event["name"] for event in events if event["event"] == "step_done" and event["ok"]]
    assert steps == ["arm", "takeoff", "goto", "goto", "goto", "return", "disarmed"]
    chosen = [event["chosen"] for event in events if event["event"] == "psmi"]
    assert chosen[:2] == [1, 2], "the first two places are the drones' own"
    assert flying.log.read_text().count("looked at 47.397") == 3
