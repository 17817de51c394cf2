"""PSMI, QoDS and control over real brokers: two fogs, three drones, and ground stations that come, go and die."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from mqttxt import Arm, Fog, Goto, GroundStation, Hold, Outcome, PsmiList, Takeoff, Word
from mqttxt.protocol.rankings import SelectMode
from mqttxt.protocol.states import Armed
from tests.rigs import prefork
from tests.rigs.processes import Broker, Process, System, eventually, free_port

pytestmark = [pytest.mark.integration, pytest.mark.apart]
CHOICES = pytest.mark.soak("services/mqttxt/src/mqttxt/activator", "services/mqttxt/src/mqttxt/station")

MAV_CMD_DO_REPOSITION = 192
FLEET = {1: (1, 2), 2: (4,)}
NEAR_2 = Goto(47.397742, 8.546526, 8)
"""30 m east of drone 2, 70 m of drone 1."""
NEAR_4 = Goto(47.401742, 8.551994, 8)
"""30 m east of drone 4, more than half a kilometre from the others."""


class TwoFogs(System):
    """A cloud, and two fogs with a broker and an activator each."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.second_fog = Broker(folder, "fog2")
        self.autopilots = {drone: self.autopilots.get(drone, free_port(socket.SOCK_DGRAM)) for drone in (1, 2, 4)}
        self.sitls = {drone: self.make_sitl(drone) for drone in self.autopilots}
        brokers = {1: self.fog.url, 2: self.second_fog.url}
        fog_of = {drone: fog for fog, drones in FLEET.items() for drone in drones}
        self.uavs = {
            drone: self.make_uav(drone, brokers[fog_of[drone]]).with_more("--endurance-s", "700")
            for drone in self.autopilots
        }
        ready = str(folder / "activator2.ready")
        options = ["--fog", "2", "--cloud", self.cloud.url, "--fog-broker", self.second_fog.url, "--drones", "4"]
        self.second_activator = Process(folder, "activator2", "mqttxt", "activator", *options, "--ready-file", ready)

    def start(self) -> TwoFogs:
        self.second_fog.start()
        self.second_activator.start()
        super().start()
        self.second_activator.wait_ready()
        return self

    def close(self) -> None:
        super().close()
        self.second_activator.kill()
        self.second_fog.kill()

    def flown_to(self) -> dict[int, int]:
        """How many goto commands each autopilot got."""
        return {drone: len(self.commanded(drone, MAV_CMD_DO_REPOSITION)) for drone in self.autopilots}


@contextlib.asynccontextmanager
async def airborne(folder: Path) -> AsyncIterator[tuple[TwoFogs, GroundStation, list[Fog]]]:
    """All three drones fly, and a station controls them."""
    system = TwoFogs(folder)
    try:
        await asyncio.to_thread(system.start)
        async with GroundStation(system.cloud.url, name="first") as station:
            fogs = await station.connect(FLEET)
            await eventually(lambda: all(known(fog, drone) for fog in fogs for drone in FLEET[fog.number]), "states")
            for command in (Arm(), Takeoff(8)):
                await asyncio.gather(*(complete(fog, command) for fog in fogs))
            yield system, station, fogs
    finally:
        await asyncio.to_thread(system.close)


def known(fog: Fog, drone: int) -> bool:
    needed = {"location", "battery", "max_groundspeed", "endurance", "armed", "landed_state"}
    return fog.drone(drone).is_controlled and needed <= set(fog.drone(drone).states)


async def complete(fog: Fog, command: Arm | Takeoff) -> None:
    outcomes = await fog.broadcast(command)
    assert outcomes.completed
    assert len(outcomes) == len(FLEET[fog.number])


async def test_the_best_drone_of_a_fog_and_of_all_fogs_is_sent_and_a_dying_station_sends_none(tmp_path: Path) -> None:
    async with airborne(tmp_path) as (system, station, fogs):
        one, two = fogs
        # One fog: the activator chooses.
        heard = [event async for event in one.best(NEAR_2)]
        lists = [event for event in heard if isinstance(event, PsmiList)]
        assert [candidate.drone for candidate in lists[0].listed] == [2, 1]
        assert heard[-1] == Outcome(**{**vars(heard[-1]), "drone": 2, "word": Word.COMPLETED})
        assert system.flown_to() == {1: 0, 2: 1, 4: 0}

        # Several fogs: each reserves its best, the station decides.
        heard = [event async for event in station.best(NEAR_4)]
        assert {event.fog: event.chosen for event in heard if isinstance(event, PsmiList)} == {1: 1, 2: 4}
        last = heard[-1]
        assert isinstance(last, Outcome)
        assert (last.fog, last.drone, last.word) == (2, 4, Word.COMPLETED)
        assert system.flown_to() == {1: 0, 2: 1, 4: 1}

        # The ranking of services says the same on both sides of the wire.
        await eventually(lambda: len(one.ranking) == 2 and len(two.ranking) == 1, "QoDS")

        # A second station watches, is told who is in control, takes over, and offers; it dies before it commits.
        second = GroundStation(system.cloud.url, name="second")
        async with second:
            (there,) = await second.connect([1])
            await eventually(lambda: there.drone(1).holder == "first", "the holder's name")
            refused = await there.drone(1).send(Hold())
            assert (refused.word, refused.reason) == (Word.DENIED, "not_in_control, first")
            await there.take_over()
            assert there.drone(1).is_controlled
            assert (await one.drone(1).send(Hold())).reason == "not_in_control, second"
            offer = second._runner.select(1, NEAR_2, SelectMode.OFFER, ttl_s=5.0, limit_s=3.0)
            async with asyncio.timeout(10):
                assert [said.drone async for said in offer if isinstance(said, Outcome)] == []
        await eventually(lambda: one.drone(2).is_controlled, "control returned to the first station")
        assert system.flown_to() == {1: 0, 2: 1, 4: 1}
        heard = [event async for event in one.best(NEAR_2, ttl_s=20)]
        assert isinstance(heard[-1], Outcome)


@CHOICES
async def test_a_nearer_drone_on_the_ground_is_passed_over_for_one_that_flies_on_another_fog(tmp_path: Path) -> None:
    async with airborne(tmp_path) as (system, station, (_, two)):
        assert (await two.drone(4).land()).completed
        await eventually(lambda: two.drone(4).states["armed"].state == Armed(False), "the fog has heard it too")
        heard: list[Outcome | PsmiList] = []
        async for event in station.best(NEAR_4):
            heard.append(event)
            if isinstance(event, Outcome) and event.word is Word.ACCEPTED:
                break  # it is half a kilometre to go
        left_out = {c.drone: c.reason for one in heard if isinstance(one, PsmiList) for c in one.left_out}
        assert left_out == {4: "disarmed"}
        sent = heard[-1]
        assert isinstance(sent, Outcome)
        assert (sent.fog, sent.word) == (1, Word.ACCEPTED)
        assert {drone: count for drone, count in system.flown_to().items() if count} == {sent.drone: 1}


@CHOICES
async def test_the_command_line_sends_the_best_of_several_fogs_and_shows_rank_and_control(tmp_path: Path) -> None:
    async with airborne(tmp_path) as (system, _, _):
        cloud = ["--cloud", system.cloud.url, "--fog", "1", "--fog", "2"]
        place = [str(NEAR_4.latitude_deg), str(NEAR_4.longitude_deg), "8"]
        refused = await run("send", "goto", *place, "--best", *cloud)
        assert refused.returncode == 1
        assert "drone 4 left out: not_in_control, first" in refused.stdout
        sent = await run("send", "goto", *place, "--best", "--take-over", *cloud)
        assert sent.returncode == 0, sent.stdout + sent.stderr
        assert "fog 2: PSMI [4]" in sent.stdout
        assert sent.stdout.splitlines()[-1] == "drone 4: goto completed"
        shown = await run("watch", *cloud)
        assert shown.returncode == 0
        lines = [[cell.strip() for cell in line.split("│")[1:-1]] for line in shown.stdout.splitlines()]
        assert any({"QoDS", "control"} <= set(line.replace("┃", " ").split()) for line in shown.stdout.splitlines())
        ranked = [line[:3] for line in lines if len(line) > 3 and line[0].isdigit()]
        assert ranked == [["1", "1", "1"], ["1", "2", "2"], ["2", "1", "4"]]


async def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return await asyncio.to_thread(prefork.run, "mqttxt", "gs", *arguments)
