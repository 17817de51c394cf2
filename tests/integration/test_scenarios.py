"""The scenarios that go somewhere, over both fleets: real stand-ins, clients and brokers, points nearby and low."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
import yaml
from processes import FLEET_FILE, Process, System, free_port

from mission import scenarios
from mission.events import EventLog
from mission.fleet import Fleet, Point
from mission.mavsdk_fleet import MavsdkFleet
from mission.mqttxt_fleet import MqttxtFleet
from mission.points import all_points
from mission.steps import Steps
from mqttxt.commands import haversine_m

pytestmark = pytest.mark.integration
DRONES = (1, 2)
LOW_M = 3.0
CONNECT_S = 40.0
SHARE = 0.12
"""How much of the way to a point is flown."""


@pytest.fixture
def low_fleet(tmp_path: Path) -> Path:
    """The fleet, returning at the height that is flown here."""
    fleet = yaml.safe_load(FLEET_FILE.read_text())
    fleet["parameters"]["RTL_RETURN_ALT"] = LOW_M
    path = tmp_path / "fleet.yaml"
    path.write_text(yaml.safe_dump(fleet))
    return path


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
    sitls = []
    for drone, port in ports.items():
        base = tmp_path / f"sitl{drone}"
        files = ["--events", f"{base}.jsonl", "--ready-file", f"{base}.ready", "--position-file", f"{base}.position"]
        ends = ["--listen", "127.0.0.1:0", "--send", f"127.0.0.1:{port}"]
        sitl = Process(
            tmp_path, base.name, "sitl", "fly", "--system", str(drone), "--fleet", str(low_fleet), *ends, *files
        )
        sitls.append(sitl)
    try:
        for sitl in sitls:
            sitl.start()
        for sitl in sitls:
            sitl.wait_ready()
        yield ports
    finally:
        for sitl in sitls:
            sitl.kill()


@pytest.fixture
def system(tmp_path: Path, low_fleet: Path) -> Iterator[System]:
    made = System(tmp_path, fleet_file=low_fleet)
    try:
        yield made.start()
    finally:
        made.close()


async def _fly(name: str, fleet: Fleet, folder: Path) -> list[tuple[str, bool]]:
    """Fly a scenario to its end; returns its steps."""
    log = EventLog(folder / "steps.jsonl", StringIO())
    try:
        await fleet.connect(CONNECT_S)
        await scenarios.SCENARIOS[name](fleet, Steps(fleet, log))
    finally:
        await fleet.close()
        log.close()
    return [(event["name"], event["ok"]) for event in _lines(folder / "steps.jsonl") if event["event"] == "step_done"]


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
        *("takeoff", "hold", "return")
    ]


STEPS_OF_2 = [(name, True) for name in ("arm", "takeoff", "goto", "return", "disarmed")]


async def test_scenario_2_over_mavlink(tmp_path: Path, autopilots: dict[int, int], near: dict[int, Point]) -> None:
    log = EventLog(tmp_path / "events.jsonl", StringIO())
    urls = tuple(f"udpin://127.0.0.1:{port}" for port in autopilots.values())
    fleet = MavsdkFleet(urls, {1: DRONES}, "one-by-one", "px4-onboard", log)
    assert await _fly("scenario-2", fleet, tmp_path) == STEPS_OF_2
    for drone, point in near.items():
        _assert_flown(tmp_path, drone, point)
        words = [
            event["word"]
            for event in _lines(tmp_path / "events.jsonl")
            if event.get("drone") == drone and "word" in event
        ]
        assert words == ["accepted", "completed"] * 4


async def test_scenario_2_over_mqttxt(tmp_path: Path, system: System, near: dict[int, Point]) -> None:
    log = EventLog(tmp_path / "events.jsonl", StringIO())
    fleet = MqttxtFleet(system.cloud.url, {1: DRONES}, 1, log)
    assert await _fly("scenario-2", fleet, tmp_path) == STEPS_OF_2
    for drone, point in near.items():
        _assert_flown(tmp_path, drone, point)
    commands = [
        (event["command"], event["drone"]) for event in _lines(tmp_path / "events.jsonl") if event["event"] == "command"
    ]
    assert commands == [("arm", None), ("takeoff", None), ("goto", 1), ("goto", 2), ("return", None)]
