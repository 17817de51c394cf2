"""The MAVLink leg signed, with the stand-in as both kinds: flights, restarts, strangers, a pilot, a new key."""

from __future__ import annotations

import socket
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink
from typer.testing import CliRunner, Result

from mqttxt import Arm, Armed, Drone, Goto, GroundStation, Hold, Land, Landed, LandedState, Takeoff, Word
from mqttxt.cli.main import app
from tests.rigs.commanding import armable, fly, start
from tests.rigs.keyed_pilot import KeyedPilot
from tests.rigs.processes import Process, System, ask_autopilot, eventually, free_port, stand_in
from tests.rigs.signing import make_key

pytestmark = [pytest.mark.integration, pytest.mark.apart]

HOME = (47.397742, 8.545594)
NORTH = Goto(HOME[0] + 0.0005, HOME[1], 12.0)
RETURN = (4, 5)
"""PX4's mode in which it comes back."""
PILOTS_PORT = 18_570
"""Where PX4 hears ground stations, as system 1."""


class KeyedSystem(System):
    """One drone with the same key at both ends; `pilots`: its autopilot has PX4's link for ground stations too."""

    def __init__(self, folder: Path, like: str = "px4", *, pilots: bool = False) -> None:
        self.key_file = folder / "drone1.key"
        self.key = make_key(self.key_file)
        self._pilots = pilots
        super().__init__(folder, like=like)

    def make_sitl(self, drone: int) -> Process:
        made = super().make_sitl(drone)
        more = ["--mavlink-key", str(self.key_file), *(["--gcs"] if self._pilots and drone == 1 else [])]
        return made.with_more(*more)

    def make_uav(self, drone: int, broker: str, **how: Any) -> Process:
        return super().make_uav(drone, broker, **how).with_more("--mavlink-key", str(self.key_file))

    @asynccontextmanager
    async def drone(self) -> AsyncIterator[Drone]:
        async with GroundStation(self.cloud.url) as station:
            (fog,) = await station.connect([1])
            found = fog.drone(1)
            await armable(found)
            yield found

    def altitude_m(self) -> float:
        return float(self.control(1, {"get": "state"})["altitude_m"])

    def kept_stamp(self) -> int:
        return int((self.folder / "uav1.mavlink-time").read_text())


@asynccontextmanager
async def flown(folder: Path, like: str = "px4", *, pilots: bool = False) -> AsyncIterator[tuple[KeyedSystem, Drone]]:
    system = KeyedSystem(folder, like, pilots=pilots)
    try:
        system.start()
        async with system.drone() as drone:
            yield system, drone
    finally:
        system.close()


def is_on_ground(drone: Drone) -> bool:
    known = drone.state(LandedState)
    return known is not None and known.state.landed is Landed.ON_GROUND


def is_disarmed(drone: Drone) -> bool:
    known = drone.state(Armed)
    return known is not None and not known.state.armed


@pytest.mark.soak(
    "services/mqttxt/src/mqttxt/drone/mavlink", "services/mqttxt/src/mqttxt/drone/process.py", "services/sitl/src/sitl"
)
@pytest.mark.parametrize("like", ["px4", "ardupilot"])
async def test_a_whole_flight_is_signed_and_survives_both_restarts(tmp_path: Path, like: str) -> None:
    """A restarted stand-in has no time of its own: it begins with its key's, decades behind the client's."""
    async with flown(tmp_path, like) as (system, drone):
        await fly(drone, Arm(), Takeoff(10.0), NORTH, Land())
        await fly(drone, Arm(), Takeoff(10.0))
        stamp = system.kept_stamp()
        heard, task = await start(drone, NORTH)
        system.uavs[1].kill()
        system.uavs[1].start().wait_ready()
        await task
        assert (heard[-1].word, heard[-1].reason) == (Word.UNCONFIRMED, "restarted")
        await eventually(lambda: drone.is_controlled and "landed_state" in drone.states, "it is back")
        await fly(drone, Hold())
        await eventually(lambda: system.kept_stamp() > stamp, "the stamps went on")
        assert system.altitude_m() > 8
        heard, task = await start(drone, Land())
        system.sitls[1].kill()
        system.sitls[1].start().wait_ready()
        await task
        assert (heard[-1].word, heard[-1].reason) == (Word.UNCONFIRMED, "autopilot_restarted")
        await eventually(lambda: is_on_ground(drone) and is_disarmed(drone), "the new one is heard, its heartbeat too")
        await armable(drone)
        await fly(drone, Arm(), Takeoff(5.0), Land())


async def test_an_unsigned_command_and_a_played_back_one_do_nothing(tmp_path: Path) -> None:
    """A client without the key is one that the autopilot does not hear, and that says which option is missing."""
    async with flown(tmp_path) as (system, drone):
        system.uavs[1].stop()
        keyless = System.make_uav(system, 1, system.fog.url, "keyless").start().wait_ready()
        try:
            await armable(drone)
            last = await drone.send(Arm())
            assert (last.word, last.reason) == (Word.UNCONFIRMED, "no_ack")
            assert not system.control(1, {"get": "state"})["armed"]
            assert "expected --mavlink-key with its key" in keyless.log.read_text()
        finally:
            keyless.kill()
        assert "Invalid signature" in system.sitls[1].log.read_text()


async def test_an_autopilot_without_the_key_is_not_believed(tmp_path: Path) -> None:
    async with flown(tmp_path) as (system, drone):
        system.sitls[1].kill()
        keyless = System.make_sitl(system, 1).start()
        try:
            await eventually(lambda: "mavlink_unsigned" in system.uavs[1].log.read_text(), "it says why")
            last = await drone.send(Hold())
            while last.word is not Word.DENIED:  # the heartbeats of before count for three seconds
                last = await drone.send(Hold())
            assert last.reason == "no_autopilot"
        finally:
            keyless.kill()


async def test_a_pilots_station_that_signs_flies_beside_ours(tmp_path: Path) -> None:
    """Both are heard on the same key; PX4's ports for ground stations are always the same, and no other test's."""
    async with flown(tmp_path, pilots=True) as (system, drone):
        with KeyedPilot(PILOTS_PORT, 1, system.key) as pilot, KeyedPilot(PILOTS_PORT, 1, None) as stranger:
            await fly(drone, Arm(), Takeoff(10.0))
            await eventually(lambda: "HEARTBEAT" in pilot.latest, "the pilot hears the autopilot")
            assert pilot.latest["HEARTBEAT"].get_signed()
            heard, task = await start(drone, Goto(HOME[0] + 0.002, HOME[1], 12.0))
            stranger.command(mavlink.MAV_CMD_NAV_LAND)
            pilot.command(mavlink.MAV_CMD_DO_SET_MODE, 1, *RETURN)
            await task
            assert (heard[-1].word, heard[-1].reason) == (Word.FAILED, "mode_changed")
            assert system.control(1, {"get": "state"})["mode"] == "return"
            assert pilot.result(mavlink.MAV_CMD_DO_SET_MODE) == mavlink.MAV_RESULT_ACCEPTED
            assert stranger.result(mavlink.MAV_CMD_NAV_LAND) is None
            await fly(drone, Land())


def typed(*words: object) -> Result:
    return CliRunner().invoke(app, ["keys", "mavlink", *map(str, words)])


@pytest.fixture
def autopilot(tmp_path: Path) -> Iterator[Callable[..., str]]:
    """Starts a stand-in; the address at which it is heard."""
    with ExitStack() as stack:

        def begin(*more: str) -> str:
            port = free_port(socket.SOCK_DGRAM)
            stack.callback(stand_in(tmp_path, 1, port, *more).start().wait_ready().kill)
            return f"udp:127.0.0.1:{port}"

        yield begin


@pytest.mark.parametrize("like", ["px4", "ardupilot"])
def test_a_key_is_installed_and_then_replaced_by_who_has_it(
    tmp_path: Path, autopilot: Callable[..., str], like: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two = tmp_path / "one.key", tmp_path / "two.key"
    wire = autopilot("--like", like)
    done = typed(one, "--install", wire, "--drone", 1)
    assert done.exit_code == 0, done.output
    assert "the key travels in the clear" in done.output
    assert typed(one, "--install", wire, "--drone", 1).exit_code == 0, "it is there already"
    assert typed(two, "--install", wire, "--drone", 1, "--old", one).exit_code == 0
    monkeypatch.setattr("mqttxt.drone.mavlink.key_install.PATIENCE_S", 2.0)
    for old in ([], ["--old", one]):
        done = typed(one, "--install", wire, "--drone", 1, *old)
        assert done.exit_code == 1
        assert f"autopilot {wire}: " in done.output


def test_an_armed_drone_gets_no_key(tmp_path: Path, autopilot: Callable[..., str]) -> None:
    wire = autopilot()
    ask_autopilot(tmp_path / "sitl1.sock", {"set": {"armed": True}})
    done = typed(tmp_path / "one.key", "--install", wire, "--drone", 1)
    assert done.exit_code == 1
    assert "drone 1 is armed" in done.output
