"""Each part is killed in mid-flight and started again: every open command has exactly one last word, nothing is
executed twice, and everything comes back by itself."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Arm, GroundStation, Land, Outcome, Takeoff, Word
from mqttxt.core.hearing import ANSWER_MS, SILENT_MS
from tests.rigs.commanding import follow
from tests.rigs.processes import ROOT, System, eventually, free_port, stand_in, wait_until

pytestmark = [pytest.mark.integration, pytest.mark.apart]

TAKEOFF, LAND = 22, 21
ALTITUDE_M = 8
STANDSTILL_S = (SILENT_MS + ANSWER_MS) / 1000 + 3


@pytest.fixture(
    params=[
        pytest.param(1, id="qos1"),
        pytest.param(
            0,
            id="qos0",
            marks=pytest.mark.soak(
                *(f"services/mqttxt/src/mqttxt/{part}" for part in ("activator", "core", "drone", "station"))
            ),
        ),
    ]
)
def fleet(request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    """Two drones on one fog, at either QoS."""
    with closing(System(tmp_path, qos=request.param)) as made:
        yield made.start()


@pytest.fixture
def silent(tmp_path: Path) -> Iterator[System]:
    """The same, of which nothing runs: neither a broker nor an activator."""
    with closing(System(tmp_path)) as made:
        yield made


async def _airborne_with_open_takeoff(fleet: System, fog: Any) -> tuple[list[Outcome], asyncio.Task[None]]:
    """Both drones climb; the broadcast takeoff is accepted and still open."""
    assert (await fog.broadcast(Arm())).completed
    heard, listening = follow(fog.broadcast(Takeoff(ALTITUDE_M), limit_s=25))
    await eventually(lambda: len(heard) == 2, "takeoff accepted by both")
    assert {outcome.word for outcome in heard} == {Word.ACCEPTED}
    return heard, listening


def _last_words(heard: list[Outcome]) -> dict[int | None, list[Word]]:
    found: dict[int | None, list[Word]] = {}
    for outcome in heard:
        if outcome.is_last:
            found.setdefault(outcome.drone, []).append(outcome.word)
    return found


async def _all_back(fog: Any) -> None:
    await eventually(lambda: fog.is_live and all(fog.drone(d).is_reachable for d in (1, 2)), "everything is back", 60)


async def _land_all(fleet: System, fog: Any) -> None:
    """The proof that commands flow again; and that each autopilot got each command once."""
    heard, landing = follow(fog.broadcast(Land()))
    await landing
    assert _last_words(heard) == {1: [Word.COMPLETED], 2: [Word.COMPLETED]}
    for drone in (1, 2):
        assert len(fleet.commanded(drone, TAKEOFF)) == 1
        assert len(fleet.commanded(drone, LAND)) == 1


@pytest.mark.parametrize("victim", ["uav", "activator", "upgraded activator", "fog broker", "cloud broker"])
async def test_kill_in_mid_flight_and_restart(fleet: System, victim: str) -> None:
    """What is upgraded gets SIGTERM, and takes leave."""
    async with GroundStation(fleet.cloud.url, qos=fleet.qos) as station:
        (fog,) = await station.connect([1])
        await _all_back(fog)
        heard, listening = await _airborne_with_open_takeoff(fleet, fog)

        part = {
            "uav": fleet.uavs[1],
            "activator": fleet.activator,
            "upgraded activator": fleet.activator,
            "fog broker": fleet.fog,
            "cloud broker": fleet.cloud,
        }[victim]
        await asyncio.to_thread(fleet.activator.stop if victim == "upgraded activator" else part.kill)
        await asyncio.to_thread(part.start)
        await _all_back(fog)
        async with asyncio.timeout(90):
            await listening

        words = _last_words(heard)
        assert {drone: len(said) for drone, said in words.items()} == {1: 1, 2: 1}
        assert words[2] == [Word.COMPLETED]
        if victim == "uav":
            assert words[1] == [Word.UNCONFIRMED]
            assert [o.reason for o in heard if o.drone == 1 and o.is_last] == ["restarted"]
        else:
            assert words[1] == [Word.COMPLETED]
        await _all_back(fog)  # the first time it may not have been noticed yet that the part was gone
        await _land_all(fleet, fog)


async def test_a_ground_station_dies_and_another_takes_over(fleet: System) -> None:
    command = [sys.executable, "-m", "mqttxt", "gs", "send", "takeoff", str(ALTITUDE_M), "--cloud", fleet.cloud.url]
    async with GroundStation(fleet.cloud.url, qos=fleet.qos) as first:
        (fog,) = await first.connect([1])
        await _all_back(fog)
        assert (await fog.broadcast(Arm())).completed
    with subprocess.Popen([*command, "--qos", str(fleet.qos)], cwd=ROOT, stdout=subprocess.DEVNULL) as dying:
        wait_until(lambda: bool(fleet.commanded(1, TAKEOFF) and fleet.commanded(2, TAKEOFF)), "takeoff commanded")
        dying.kill()

    async with GroundStation(fleet.cloud.url, qos=fleet.qos) as second:
        (fog,) = await second.connect([1])
        await _all_back(fog)
        height = {drone: fleet.control(drone, {"get": "state"})["altitude_m"] for drone in (1, 2)}
        await eventually(
            lambda: all(fleet.control(d, {"get": "state"})["altitude_m"] > ALTITUDE_M - 0.5 for d in (1, 2)),
            f"the drones finish what they were told (from {height})",
        )
        await _land_all(fleet, fog)


async def test_a_cloud_broker_that_stands_still_costs_nobody_control(system: System) -> None:
    """For less than the keep-alive, and long enough for everybody to have heard nothing."""
    async with GroundStation(system.cloud.url, name="alpha") as alpha:
        (fog,) = await alpha.connect([1])
        async with GroundStation(system.cloud.url, name="beta") as beta:
            (watched,) = await beta.connect([1])
            await eventually(lambda: fog.drone(1).is_controlled, "alpha is in control")
            system.cloud.stall()
            await asyncio.sleep(STANDSTILL_S)
            system.cloud.go_on()
            assert (await fog.drone(1).arm()).completed
            assert watched.drone(1).holder == "alpha"
    assert "delivers nothing" not in system.activator.said()


async def test_a_query_after_the_deadline_is_answered_from_the_ledger(system: System) -> None:
    async with GroundStation(system.cloud.url) as station:
        (fog,) = await station.connect([1])
        await _all_back(fog)
        armed = await fog.drone(1).send(Arm(), ttl_s=3)
        assert armed.completed
        inside = station._runner
        pending = inside.station.commands.pending[armed.id]
        await eventually(lambda: inside.clock.now_ms() > pending.close_at_ms - 19_000, "the deadline has passed")
        events = station.events()
        pending.words.clear()
        inside.carry_out([pending.publish])
        async with asyncio.timeout(30):
            assert (await anext(event async for event in events if isinstance(event, Outcome))).completed
        assert len(system.commanded(1, 400)) == 1


async def test_a_second_uav_client_of_a_number_is_refused(system: System) -> None:
    async with GroundStation(system.cloud.url) as station:
        (fog,) = await station.connect([1])
        await _all_back(fog)
        twin = system.make_uav(1, system.fog.url, name="twin", autopilot_port=_second_sitl(system))
        twin.start()
        try:
            code = await asyncio.to_thread(twin.wait)
        finally:
            twin.kill()
        assert code == 1
        assert "refused: another live UAV client is drone 1 already" in twin.log.read_text()
        assert system.uavs[1].exit_code is None
        await _all_back(fog)
        assert (await fog.drone(1).hold()).completed


def _second_sitl(system: System) -> int:
    """Another autopilot that claims to be drone 1, as a mistake in a fleet would have it."""
    port = free_port(socket.SOCK_DGRAM)
    system.sitls[99] = stand_in(system.folder, 1, port, name="twin-sitl").start().wait_ready()
    return port


async def test_a_second_activator_of_a_fog_refuses_to_start(system: System) -> None:
    rival = system.make_activator(system.cloud.url, system.fog.url, name="rival").start()
    try:
        assert await asyncio.to_thread(rival.wait) == 1
    finally:
        rival.kill()
    assert "refused: another live activator is fog 1 already" in rival.log.read_text()
    assert system.activator.exit_code is None


async def test_an_unknown_kind_of_autopilot_is_refused_before_anything_is_connected(silent: System) -> None:
    port = free_port(socket.SOCK_DGRAM)
    stranger = silent.make_uav(7, silent.fog.url, name="of-no-kind", autopilot_port=port).start()
    codec = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    heartbeat = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_UDB, 0, 0, 4, 3).pack(codec)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
            while stranger.exit_code is None:
                autopilot.sendto(heartbeat, ("127.0.0.1", port))
                await asyncio.sleep(0.1)
        assert stranger.exit_code == 2
    finally:
        stranger.kill()
    log = stranger.log.read_text()
    assert (
        f"--autopilot udp:127.0.0.1:{port}: HEARTBEAT.autopilot is {mavlink.MAV_AUTOPILOT_UDB}, its type 2; "
        "expected PX4 (12), ArduPilot's multicopters (3)" in log
    )
    assert "Traceback" not in log
