"""The MAVSDK fleet flies real stand-ins, directly and through real routers, and says what went wrong when it does."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import threading
from collections.abc import AsyncIterator
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from mission import mavsdk_drone, scenarios
from mission.events import EventLog
from mission.fleet import CommandResult, MissionError
from mission.mavsdk_fleet import MavsdkFleet
from mission.steps import Steps
from tests.rigs.processes import Process, ask_autopilot, eventually, free_port, stand_in
from tests.rigs.routers import Router, chain

pytestmark = [pytest.mark.integration, pytest.mark.apart]
BATTERY_STATUS, GLOBAL_POSITION_INT, VFR_HUD, EXTENDED_SYS_STATE = 147, 33, 74, 245
ARM, SET_MESSAGE_INTERVAL = 400, 511
LOW_M = 3.0
OTHERS = pytest.mark.soak(
    *(f"services/mission/src/mission/{name}.py" for name in ("mavsdk_calls", "mavsdk_drone", "mavsdk_fleet", "steps")),
    "services/router/src",
)
CONNECT_S = 40.0


class Sky:
    """Stand-ins on loopback, each with an address where its messages go, and fleets that listen there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sitls: dict[str, Process] = {}
        self.routers: list[Router] = []
        self.fleets: list[tuple[MavsdkFleet, EventLog]] = []

    def fly(self, drone: int, port: int, streams: str = "px4-onboard", name: str | None = None) -> Process:
        """Start a stand-in that sends to a port."""
        sitl = stand_in(self.folder, drone, port, "--streams", streams, name=name).start().wait_ready()
        self.sitls[sitl.name] = sitl
        return sitl

    def chain(self, drone: int, port: int, hops: int = 3) -> int:
        """A chain of routers that ends at a port; returns where the drone's autopilot sends to."""
        ports = [*(free_port(socket.SOCK_DGRAM) for _ in range(hops)), port]
        routers = chain(self.folder, ports, 190 + 10 * drone)
        self.routers += [router.start() for router in routers]
        return ports[0]

    def fleet(
        self,
        ports: dict[int, int],
        commanding: str = "one-by-one",
        streams: str = "px4-onboard",
        fogs: dict[int, tuple[int, ...]] | None = None,
        urls: tuple[str, ...] = (),
    ) -> MavsdkFleet:
        """A fleet of one fog that listens at the port of each drone, unless told otherwise."""
        log = EventLog(self.folder / "events.jsonl", StringIO())
        at_ports = tuple(f"udpin://127.0.0.1:{port}" for port in ports.values())
        made = MavsdkFleet(urls or at_ports, fogs or {1: tuple(ports)}, commanding, streams, log)
        self.fleets.append((made, log))
        return made

    async def flown(self, *drones: int) -> MavsdkFleet:
        """A fleet of one fog with a stand-in for each of these drones, connected to them."""
        ports = _ports(*drones)
        for drone, port in ports.items():
            self.fly(drone, port)
        fleet = self.fleet(ports)
        await fleet.connect(CONNECT_S)
        return fleet

    def events(self, kind: str) -> list[dict[str, Any]]:
        """What the fleet wrote down."""
        lines = (self.folder / "events.jsonl").read_text().splitlines()
        return [event for event in map(json.loads, lines) if event["event"] == kind]

    def is_said(self, drone: int, command: str, word: str) -> bool:
        said = [(event["drone"], event["command"], event["word"]) for event in self.events("outcome")]
        return (drone, command, word) in said

    def commands(self, drone: int, number: int) -> list[list[float]]:
        """The parameters of each MAV_CMD that an autopilot received."""
        lines = (self.folder / f"sitl{drone}.jsonl").read_text().splitlines()
        heard = [event for event in map(json.loads, lines) if event["event"] == "command"]
        return [event["params"] for event in heard if event["command"] == number]

    def control(self, name: str, request: dict[str, Any]) -> dict[str, Any]:
        """The side channel of a stand-in."""
        return ask_autopilot(self.folder / f"{name}.sock", request)


@pytest.fixture
async def sky(tmp_path: Path) -> AsyncIterator[Sky]:
    made = Sky(tmp_path)
    try:
        yield made
    finally:
        for fleet, log in made.fleets:
            await fleet.close()
            log.close()
        for router in made.routers:
            router.kill()
        for sitl in made.sitls.values():
            sitl.kill()


@pytest.fixture(autouse=True)
def _no_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenarios, "HOLD_S", 1.0)
    monkeypatch.setattr(mavsdk_drone, "LOST_S", 1.0)


def _ports(*drones: int) -> dict[int, int]:
    return {drone: free_port(socket.SOCK_DGRAM) for drone in drones}


def _completed(*drones: int) -> list[CommandResult]:
    return [CommandResult(drone, "completed") for drone in drones]


async def test_a_takeoff_altitude_that_is_not_told_at_first_is_asked_for_again(sky: Sky) -> None:
    (port,) = _ports(1).values()
    sky.fly(1, port)
    sky.control("sitl1", {"set": {"mute": ["PARAM_VALUE"]}})
    fleet = sky.fleet({1: port})
    connecting = asyncio.create_task(fleet.connect(CONNECT_S))
    await eventually(lambda: "(takeoff altitude: parameter_error)" in str(fleet._missing()), "asked in vain")
    sky.control("sitl1", {"set": {"mute": []}})
    await connecting


@pytest.mark.parametrize(
    ("commanding", "streams", "altitude_m"),
    [
        ("one-by-one", "px4-onboard", 10.0),
        pytest.param("concurrent", "five-states", LOW_M, marks=OTHERS),
        pytest.param("concurrent", "px4-gcs", LOW_M, marks=OTHERS),
    ],
)
async def test_scenario_1_directly(
    sky: Sky, commanding: str, streams: str, altitude_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenarios, "ALTITUDE_M", altitude_m)
    ports = _ports(1, 2, 3)
    for drone, port in ports.items():
        sky.fly(drone, port, streams)
    fleet = sky.fleet(ports, commanding, streams)
    await fleet.connect(CONNECT_S)
    await scenarios.scenario_1(fleet, Steps(fleet, EventLog(sky.folder / "steps.jsonl", StringIO())))
    calls = [(event["command"], event["drone"]) for event in sky.events("command")]
    assert calls == [(command, drone) for command in ("arm", "takeoff", "land") for drone in ports]
    _assert_order(sky, commanding)
    for drone in ports:
        words = [event["word"] for event in sky.events("outcome") if event["drone"] == drone]
        assert words == ["accepted", "completed"] * 3
        assert len(sky.commands(drone, ARM)) == 1
        assert fleet.status(drone).armed is False
        _assert_streams_asked_for(sky, drone, streams)


def _assert_order(sky: Sky, commanding: str) -> None:
    """One by one, a call begins after the one before it was acknowledged; concurrently, before."""
    begun = {event["call"]: event["t_ns"] for event in sky.events("command") if event["command"] == "arm"}
    accepted = {event["call"]: event["t_ns"] for event in sky.events("outcome") if event["word"] == "accepted"}
    in_turn = [begun[call] >= accepted[call - 1] for call in (2, 3)]
    assert in_turn == [commanding == "one-by-one"] * 2


def _assert_streams_asked_for(sky: Sky, drone: int, streams: str) -> None:
    """The last interval of each message that was asked for: 1 Hz of the states, and EXTENDED_SYS_STATE's own."""
    asked = {int(params[0]): params[1] for params in sky.commands(drone, SET_MESSAGE_INTERVAL)}
    states = dict.fromkeys((BATTERY_STATUS, GLOBAL_POSITION_INT, VFR_HUD), 1e6) if streams == "five-states" else {}
    assert asked == {**states, EXTENDED_SYS_STATE: 0.0}


@OTHERS
async def test_scenario_1_through_a_chain_of_routers_for_each_drone(sky: Sky, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenarios, "ALTITUDE_M", LOW_M)
    ports = _ports(1, 2)
    for drone, port in ports.items():
        sky.fly(drone, sky.chain(drone, port))
    fleet = sky.fleet(ports)
    await fleet.connect(CONNECT_S)
    await scenarios.scenario_1(fleet, Steps(fleet, EventLog(sky.folder / "steps.jsonl", StringIO())))
    assert [fleet.status(drone).armed for drone in ports] == [False, False]


@OTHERS
async def test_vehicles_share_a_connection_and_another_altitude_is_set_before_the_takeoff(sky: Sky) -> None:
    port = free_port(socket.SOCK_DGRAM)
    for drone in (1, 2):
        sky.fly(drone, port)
    fleet = sky.fleet({1: port}, "concurrent", fogs={1: (1,), 2: (2,)})
    await fleet.connect(CONNECT_S)
    assert await fleet.arm() == _completed(1, 2)
    assert await fleet.takeoff(LOW_M) == _completed(1, 2)
    assert sky.control("sitl1", {"get": "state"})["altitude_m"] < LOW_M + 0.5
    assert {event["fog"] for event in sky.events("command") if event["drone"] == 2} == {2}


async def test_a_vehicle_that_never_appears_is_named(sky: Sky) -> None:
    ports = _ports(1, 2)
    sky.fly(1, ports[1])
    sky.fly(5, ports[2])
    with pytest.raises(MissionError, match=r"not there: drone 2 never appeared \(heard system 5\)$"):
        await sky.fleet(ports).connect(12)


async def test_two_vehicles_with_one_system_id_are_named(sky: Sky) -> None:
    ports = _ports(1, 2)
    sky.fly(1, ports[1])
    sky.fly(1, ports[2], name="twin")
    with pytest.raises(MissionError, match=r"drone 1: heartbeats twice as often .* two vehicles have system id 1"):
        await sky.fleet(ports).connect(CONNECT_S)


async def test_an_address_that_cannot_be_used_is_named(sky: Sky) -> None:
    with pytest.raises(MissionError, match="connect: udpin://nowhere:port: "):
        await sky.fleet({1: 0}, urls=("udpin://nowhere:port",)).connect(5)


async def test_a_denied_arm_is_one_drones_result(sky: Sky) -> None:
    fleet = await sky.flown(1, 2)
    sky.control("sitl1", {"set": {"healthy": False}})
    assert await fleet.arm() == [CommandResult(1, "denied", "autopilot"), *_completed(2)]


@OTHERS
async def test_a_router_that_dies_while_a_takeoff_is_flown(sky: Sky) -> None:
    ports = _ports(1, 2)
    sky.fly(1, ports[1])
    sky.fly(2, sky.chain(2, ports[2], hops=2))
    fleet = sky.fleet(ports)
    await fleet.connect(CONNECT_S)
    await fleet.arm()
    taking_off = asyncio.create_task(fleet.takeoff(10.0))
    await eventually(lambda: sky.is_said(2, "takeoff", "accepted"), "the takeoff was accepted")
    sky.routers[0].kill()
    assert await taking_off == [*_completed(1), CommandResult(2, "unconfirmed", "heartbeat_lost")]
    steps = Steps(fleet, EventLog(sky.folder / "steps.jsonl", StringIO()))
    with pytest.raises(MissionError, match=r"^hold: drone 2: heartbeats stopped$"):
        await steps.hold(60)


@OTHERS
async def test_a_vehicle_that_freezes_leaves_its_command_unconfirmed_and_keeps_its_streams(sky: Sky) -> None:
    fleet = await sky.flown(1, 2)
    await fleet.arm()
    await fleet.takeoff(LOW_M)
    before = len(_intervals(sky, 1))
    sky.sitls["sitl1"].stall()
    assert await fleet.land() == [CommandResult(1, "unconfirmed", "timeout"), *_completed(2)]
    sky.sitls["sitl1"].go_on()
    await eventually(lambda: _intervals(sky, 1)[before:][-1:] == [0.0], "what MAVSDK asks for by itself is put back")


async def test_a_lost_acknowledgement_is_unconfirmed(sky: Sky) -> None:
    fleet = await sky.flown(1)
    sky.control("sitl1", {"set": {"mute": ["COMMAND_ACK"]}})
    assert await fleet.arm() == [CommandResult(1, "unconfirmed", "timeout")]
    await eventually(lambda: len(sky.commands(1, ARM)) >= 4, "MAVSDK sends a command four times")
    assert len(sky.commands(1, ARM)) == 4


async def test_closed_in_the_middle_of_a_call_nothing_of_mavsdk_stays(sky: Sky) -> None:
    before = _foreign_threads()
    fleet = await sky.flown(1)
    sky.sitls["sitl1"].stall()
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.3):
            await fleet.arm()
    await fleet.close()
    await eventually(lambda: _foreign_threads() <= before, "no thread of MAVSDK's is left")


def _intervals(sky: Sky, drone: int) -> list[float]:
    """Those of EXTENDED_SYS_STATE that were asked for, in microseconds.

    MAVSDK leaves out its own request where the one that puts it back is in its queue already.
    """
    return [params[1] for params in sky.commands(drone, SET_MESSAGE_INTERVAL) if params[0] == EXTENDED_SYS_STATE]


def _foreign_threads() -> set[int]:
    """Threads of this process that Python did not make."""
    return {int(task) for task in os.listdir("/proc/self/task")} - {one.native_id for one in threading.enumerate()}
