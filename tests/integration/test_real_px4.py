"""MQTT-XT flies a real PX4: what it must not do, what stops it, pilots, and whoever is killed (PX4_DIR=FOLDER)."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from copter import HOME, SYSTEM
from processes import Broker, Process, eventually
from px4 import FOLDER, HOLD, LAND, OFFBOARD, RETURN, TAKEOFF, Px4, Station

from mqttxt import (
    Arm,
    Command,
    Disarm,
    Drone,
    Goto,
    GroundStation,
    Hold,
    Land,
    Offboard,
    Outcome,
    Return,
    Takeoff,
    Velocity,
    Word,
)

pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(400),
    pytest.mark.skipif(not FOLDER, reason="PX4_DIR names no folder with bin/px4 and etc of a PX4"),
]

BOOT_S = 180.0
"""A PX4 that was started anew arms after 30 to 45 s; later on a machine that does something else."""
NORTH, BACK = Goto(HOME[0] + 0.002, HOME[1], 15.0), Goto(HOME[0], HOME[1], 15.0)
SOUTHWARDS = Offboard(60.0, velocity=Velocity(-2.0, 0.0, 0.0))
FLIGHTS: dict[str, tuple[Command, tuple[int, int]]] = {
    "takeoff": (Takeoff(25.0), TAKEOFF),
    "goto": (NORTH, HOLD),
    "land": (Land(), LAND),
    "return": (Return(), RETURN),
    "offboard": (SOUTHWARDS, OFFBOARD),
}


class Flight:
    """PX4, the brokers and the roles, for all tests of this file."""

    def __init__(self, folder: Path) -> None:
        self.cloud, self.fog = Broker(folder, "cloud"), Broker(folder, "fog")
        self.px4 = Px4(folder, SYSTEM)
        self.pilot = Station(self.px4.pilots_port)
        fog = ["--fog", "1", "--cloud", self.cloud.url, "--fog-broker", self.fog.url, "--drones", str(SYSTEM)]
        self.activator = Process(
            folder, "activator", "mqttxt", "activator", *fog, "--ready-file", str(folder / "activator.ready")
        )
        drone = ["--drone", str(SYSTEM), "--broker", self.fog.url, "--autopilot", f"udp:127.0.0.1:{self.px4.port}"]
        files = ["--journal", str(folder / "uav.journal"), "--ready-file", str(folder / "uav.ready")]
        self.uav = Process(folder, "uav", "mqttxt", "uav", *drone, *files)

    def start(self) -> None:
        for broker in (self.cloud, self.fog):
            broker.start()
        self.start_px4()
        for role in (self.activator.start(), self.uav.start()):
            role.wait_ready()

    def start_px4(self) -> None:
        self.px4.start()
        self.pilot.watch().watch_health()

    def close(self) -> None:
        self.pilot.close()
        for process in (self.uav, self.activator, self.px4, self.fog, self.cloud):
            process.kill()


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    made = Flight(tmp_path_factory.mktemp("flight"))
    try:
        made.start()
        yield made
    finally:
        made.close()


@pytest.fixture
async def drone(flight: Flight) -> AsyncIterator[Drone]:
    """The drone on the ground, disarmed, and under this station's control; it is brought down afterwards."""
    async with GroundStation(flight.cloud.url) as station:
        (fog,) = await station.connect([1])
        found = fog.drone(SYSTEM)
        await _armable(found)
        flight.pilot.highest_m = flight.pilot.position_m[2]
        yield found
        if flight.pilot.armed:
            flight.pilot.set_px4_mode(LAND)
            await eventually(lambda: not flight.pilot.armed, "landed", 120)


def _is_armable(drone: Drone) -> bool:
    health = drone.states.get("health")
    return drone.is_controlled and health is not None and health.state.armable  # type: ignore[union-attr]


async def _armable(drone: Drone) -> None:
    await eventually(lambda: _is_armable(drone), "the drone is reachable and would arm", BOOT_S)


async def _fly(drone: Drone, *commands: Command) -> None:
    for command in commands:
        last = await drone.send(command)
        assert (last.word, last.reason) == (Word.COMPLETED, None), command


async def _start(drone: Drone, command: Command) -> tuple[list[Outcome], asyncio.Task[None]]:
    """Send a command and go on once it was accepted."""
    heard: list[Outcome] = []

    async def listen() -> None:
        async for outcome in drone.outcomes(command):
            heard.append(outcome)

    task = asyncio.create_task(listen())
    await eventually(lambda: bool(heard), f"{command.name} is answered")
    assert heard[0].word is Word.ACCEPTED, heard
    return heard, task


async def _begin(flight: Flight, drone: Drone, name: str) -> tuple[list[Outcome], asyncio.Task[None]]:
    """Fly until a command is under way, which a heartbeat shows."""
    command, mode = FLIGHTS[name]
    await _fly(drone, Arm())
    if name != "takeoff":
        await _fly(drone, Takeoff(15.0))
    if name == "return":
        await _fly(drone, Goto(HOME[0] + 0.0005, HOME[1], 15.0))
    heard, task = await _start(drone, command)
    moves = {"takeoff": lambda: flight.pilot.position_m[2] > 3, "land": lambda: flight.pilot.position_m[2] < 14}
    is_moving = moves.get(name, lambda: flight.pilot.speed_m_s > 1)
    await eventually(lambda: flight.pilot.px4_mode == mode and is_moving(), f"{name} is under way")
    return heard, task


async def test_a_takeoff_while_disarmed_does_not_climb_with_the_next_arm(flight: Flight, drone: Drone) -> None:
    ground_m = flight.pilot.highest_m
    last = await drone.send(Takeoff(10.0))
    assert (last.word, last.reason) == (Word.DENIED, "disarmed")
    await _fly(drone, Arm())
    last = await drone.send(NORTH)
    assert (last.word, last.reason) == (Word.DENIED, "on_ground")
    await _fly(drone, Hold())
    await asyncio.sleep(3)
    assert (flight.pilot.px4_mode, flight.pilot.landed) == (HOLD, True)
    assert flight.pilot.highest_m - ground_m < 1.0
    await _fly(drone, Disarm())


async def test_hold_stops_a_goto_and_stays(flight: Flight, drone: Drone) -> None:
    await _fly(drone, Arm(), Takeoff(15.0))
    for there in (NORTH, BACK):
        heard, task = await _start(drone, there)
        await eventually(lambda: flight.pilot.speed_m_s > 4.0, "it is on its way")
        told_at, from_m = time.monotonic(), flight.pilot.position_m
        await _fly(drone, Hold())
        assert time.monotonic() - told_at < 6.0  # five to stand still, and one that shows it
        await task
        assert heard[-1].word is Word.SUPERSEDED
        held_m = flight.pilot.position_m
        assert abs(held_m[0] - from_m[0]) < 20
        await asyncio.sleep(5)
        assert max(abs(now - then) for now, then in zip(flight.pilot.position_m, held_m, strict=True)) < 1.5
    await _fly(drone, Land())


async def test_without_gps_it_would_not_arm_and_says_so_with_px4(flight: Flight, drone: Drone) -> None:
    """How long PX4 takes to notice is its own: the station knows within a second of PX4's SYS_STATUS."""
    flight.pilot.set_whole_parameter("SIM_GPS_USED", 0)
    try:
        await eventually(lambda: not flight.pilot.would_arm, "PX4 says so", 30)
        await eventually(lambda: not _is_armable(drone), "the station knows", 1)
        assert (await drone.send(Arm())).word is Word.DENIED
    finally:
        flight.pilot.set_whole_parameter("SIM_GPS_USED", 10)
    await _armable(drone)


@pytest.mark.parametrize("name", FLIGHTS)
async def test_a_pilots_mode_ends_what_runs_within_a_second(flight: Flight, drone: Drone, name: str) -> None:
    heard, task = await _begin(flight, drone, name)
    mode = RETURN if name == "land" else LAND
    taken_at = time.monotonic()
    flight.pilot.set_px4_mode(mode)
    await task
    assert time.monotonic() - taken_at < 1.0
    assert (heard[-1].word, heard[-1].reason) == (Word.FAILED, "mode_changed")
    assert flight.pilot.px4_mode == mode
    await _fly(drone, Land())


@pytest.mark.parametrize("name", FLIGHTS)
async def test_after_the_client_was_killed_nobody_knows_and_hold_works(flight: Flight, drone: Drone, name: str) -> None:
    heard, task = await _begin(flight, drone, name)
    flight.uav.kill()
    flight.uav.start().wait_ready()
    await task
    assert (heard[-1].word, heard[-1].reason) == (Word.UNCONFIRMED, "restarted")
    await eventually(lambda: drone.is_controlled and "landed_state" in drone.states, "it is back")
    await _fly(drone, Hold(), Land())


@pytest.mark.parametrize("name", FLIGHTS)
async def test_a_px4_that_is_killed_completes_nothing_and_is_flown_anew(
    flight: Flight, drone: Drone, name: str
) -> None:
    heard, task = await _begin(flight, drone, name)
    flight.px4.kill()
    flight.start_px4()
    await task
    assert heard[-1].word in (Word.UNCONFIRMED, Word.FAILED)
    await _armable(drone)
    await _fly(drone, Arm(), Disarm())
