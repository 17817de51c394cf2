"""A real autopilot with a key, where its version signs, and what a client with a key does where it does not."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import pytest

from mqttxt import Arm, Drone, Goto, Hold, Land, Takeoff, Word
from mqttxt.drone.mavlink.key_install import Installation
from mqttxt.drone.mavlink.signing import read_key
from mqttxt.drone.mavlink.transports import AutopilotAddress
from mqttxt.errors import TransportError
from tests.rigs import copter, px4
from tests.rigs.commanding import armable, fly, start
from tests.rigs.processes import Process, eventually
from tests.rigs.real_flights import HOME, SYSTEM, Flight
from tests.rigs.signing import make_key


def _px4(folder: Path) -> Flight:
    autopilot = px4.Px4(folder)
    return Flight(folder, autopilot, px4.Px4Pilot(autopilot.pilots_port), folder / "drone.key")


def _copter(folder: Path) -> Flight:
    autopilot = copter.Copter(folder, by_usb=False)
    return Flight(folder, autopilot, copter.CopterPilot(autopilot.pilots_port), folder / "drone.key")


REAL: dict[str, tuple[str, Callable[[Path], Flight]]] = {
    "px4": (px4.FOLDER, _px4),
    "ardupilot": (copter.FOLDER, _copter),
}
NORTH = Goto(HOME[0] + 0.002, HOME[1], 15.0)

pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(400),
    pytest.mark.skipif(not any(folder for folder, _ in REAL.values()), reason="neither PX4_DIR nor ARDUPILOT_DIR"),
]


@pytest.fixture(scope="module", params=[name for name, (folder, _) in REAL.items() if folder])
def flight(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    folder = tmp_path_factory.mktemp(request.param)
    make_key(folder / "drone.key")
    with REAL[request.param][1](folder) as made:
        yield made


@pytest.fixture
async def drone(flight: Flight) -> AsyncIterator[Drone]:
    if not flight.signs:
        pytest.skip("this version does not sign")
    async with flight.drone() as drone:
        yield drone


async def test_a_client_with_a_key_hears_nobody_who_does_not_sign(flight: Flight) -> None:
    if flight.signs:
        pytest.skip("this version signs")
    await eventually(lambda: "mavlink_unsigned" in flight.uav.log.read_text(), "it says why")
    assert not flight.uav.ready_file.exists()


async def test_a_whole_flight_is_signed(flight: Flight, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(10.0), Goto(HOME[0] + 0.0003, HOME[1], 12.0), Land())
    assert flight.pilot.latest["HEARTBEAT"].get_header().incompat_flags & 1


async def test_a_client_that_is_killed_in_flight_comes_back(flight: Flight, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(10.0))
    heard, task = await start(drone, NORTH)
    flight.uav.kill()
    flight.uav.start().wait_ready()
    await task
    assert (heard[-1].word, heard[-1].reason) == (Word.UNCONFIRMED, "restarted")
    await eventually(lambda: drone.is_controlled and "landed_state" in drone.states, "it is back")
    await fly(drone, Hold(), Land())


async def test_an_autopilot_that_is_killed_in_flight_comes_back_with_its_key(flight: Flight, drone: Drone) -> None:
    await fly(drone, Arm(), Takeoff(10.0))
    heard, task = await start(drone, NORTH)
    flight.autopilot.kill()
    flight.start_autopilot()
    await task
    assert heard[-1].word in (Word.UNCONFIRMED, Word.FAILED)
    await armable(drone)
    await fly(drone, Arm(), Takeoff(5.0), Land())


async def test_a_client_without_the_key_is_not_heard(flight: Flight, drone: Drone) -> None:
    flight.uav.stop()
    keyless = Process(flight.folder, "keyless", "mqttxt", "uav", *flight.uav_options("keyless")).start().wait_ready()
    try:
        await eventually(lambda: drone.is_controlled and "landed_state" in drone.states, "it is there")
        last = await drone.send(Arm())
        assert (last.word, last.reason) == (Word.UNCONFIRMED, "no_ack")
        assert not flight.pilot.armed
        assert "expected --mavlink-key with its key" in keyless.log.read_text()
    finally:
        keyless.stop()
        flight.uav.start().wait_ready()


def test_another_key_needs_the_old_one(flight: Flight, tmp_path: Path) -> None:
    """At the end: the autopilot has the new one then."""
    if not flight.signs:
        pytest.skip("this version does not sign")
    flight.uav.stop()
    wire = AutopilotAddress("udp", "127.0.0.1", flight.autopilot.port)
    assert flight.key_file is not None
    old, new = read_key(flight.key_file), make_key(tmp_path / "new.key")
    with pytest.raises(TransportError, match="it does not sign with this key"):
        asyncio.run(Installation(wire, SYSTEM, new).run())
    asyncio.run(Installation(wire, SYSTEM, new, old).run())
