"""How MQTT-XT's states come in a mission: on change, five of them at a fixed rate, or those in bundles."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections import Counter
from collections.abc import AsyncIterator
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import MQTTMessage

from mission.events import EventLog
from mission.mqttxt_fleet import FIVE_STATES, MqttxtFleet
from tests.rigs.plain_client import plain_client
from tests.rigs.processes import System, eventually

pytestmark = [pytest.mark.integration, pytest.mark.apart]

DRONES = (1, 2)
TURNS = 4
SET_MESSAGE_INTERVAL = 511


class Flown:
    """A fleet that has set up, what its ground station wrote down since, and how often each topic was published since
    at the two brokers."""

    def __init__(self, system: System, fleet: MqttxtFleet, events: Path) -> None:
        self.system = system
        self.fleet = fleet
        self._path = events
        self._before = len(self.events())
        self.cloud: Counter[str] = Counter()
        self.fog: Counter[str] = Counter()

    def events(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self._path.read_text().splitlines()]

    def states(self) -> Counter[tuple[int, str]]:
        """How often each state of each drone was told since."""
        told = [event for event in self.events()[self._before :] if event["event"] == "state"]
        return Counter((event["drone"], event["name"]) for event in told)

    async def turns(self) -> Counter[tuple[int, str]]:
        """Wait until every one of the five states of each drone was told some times."""
        wanted = [(drone, name) for drone in DRONES for name in FIVE_STATES]
        await eventually(lambda: all(self.states()[key] >= TURNS for key in wanted), f"five states, {TURNS} times each")
        return self.states()


@contextlib.asynccontextmanager
async def set_up(folder: Path, states: str, streams: str = "px4-normal") -> AsyncIterator[Flown]:
    """A fog with two drones and its fleet, whose clients bundle where the mission asks for bundles."""
    system = System(folder, streams=streams)
    if states == "bundle":
        system.uavs = {drone: system.make_uav(drone, system.fog.url).with_more("--bundles") for drone in DRONES}
    async with contextlib.AsyncExitStack() as stack:
        stack.push_async_callback(asyncio.to_thread, system.close)
        await asyncio.to_thread(system.start)
        log = EventLog(folder / "events.jsonl", StringIO())
        stack.callback(log.close)
        fleet = MqttxtFleet(system.cloud.url, {1: DRONES}, 1, log, states)
        stack.push_async_callback(fleet.close)
        await fleet.connect(30)
        flown = Flown(system, fleet, folder / "events.jsonl")
        for broker, counted in ((system.cloud, flown.cloud), (system.fog, flown.fog)):
            hear = partial(_count, counted)
            stack.enter_context(plain_client(broker.port, "#", heard=hear))
        yield flown


def _count(counted: Counter[str], message: MQTTMessage) -> None:
    counted[message.topic] += 1


@pytest.mark.parametrize("streams", ["px4-normal", "five-states"])
async def test_fixed_tells_five_states_in_step_though_nothing_changes(tmp_path: Path, streams: str) -> None:
    async with set_up(tmp_path, "fixed", streams) as flown:
        told = await flown.turns()
        counts = [told[drone, name] for drone in DRONES for name in FIVE_STATES]
        assert max(counts) <= TURNS + 3
        repeats = [told[drone, name] for drone in DRONES for name in ("armed", "landed_state")]
        assert max(repeats) <= 1, "what does not change is only repeated, every 30 s"
        assert not [topic for topic in flown.cloud if topic.endswith("/states")]
        assert flown.cloud["fog1/drone2/state/heading"] >= TURNS - 1


async def test_bundle_tells_the_same_in_one_message_a_second_on_both_hops(tmp_path: Path) -> None:
    async with set_up(tmp_path, "bundle") as flown:
        await flown.turns()
        alone = [topic for counted in (flown.fog, flown.cloud) for topic in counted if "/state/" in topic]
        assert alone == []
        assert min(flown.fog[f"drone{drone}/states"] for drone in DRONES) >= TURNS - 1
        assert flown.cloud["fog1/states"] <= 3 * flown.fog["drone1/states"]


@pytest.mark.parametrize("states", ["bundle", "fixed"])
async def test_words_of_a_broadcast_leave_together_for_a_station_that_bundles(tmp_path: Path, states: str) -> None:
    async with set_up(tmp_path, states) as flown:
        assert [result.word for result in await flown.fleet.arm()] == ["completed", "completed"]
        outcomes = [(e["drone"], e["word"]) for e in flown.events() if e["event"] == "outcome"]
        for drone in DRONES:
            said = [word for of, word in outcomes if of == drone]
            assert said == ["accepted", "completed"] or (states == "bundle" and said == ["completed"])
        below = [f"drone{drone}/commands_result/arm" for drone in DRONES]

        def came() -> tuple[int, int]:
            """Messages of the fog, with the roster or words together, and with one word."""
            heard = flown.cloud
            return heard["fog1/commands_result/arm"], sum(heard[f"fog1/{topic}"] for topic in below)

        if states == "fixed":
            await eventually(lambda: came() == (1, 4), "the roster and each word came alone")
        else:
            await eventually(lambda: came()[0] >= 1, "the roster came")
            assert sum(came()) < 1 + sum(flown.fog[topic] for topic in below)


async def test_on_change_asks_for_no_rate_and_repeats_nothing(tmp_path: Path) -> None:
    async with set_up(tmp_path, "on-change") as flown:
        assert [result.word for result in await flown.fleet.arm()] == ["completed", "completed"]
        await eventually(lambda: all(flown.states()[drone, "armed"] for drone in DRONES), "armed")
        assert not [drone for drone in DRONES if _asked_by(flown, drone)]
        assert flown.states()[1, "battery"] <= 1


async def test_setting_up_is_no_call_of_the_mission(tmp_path: Path) -> None:
    async with set_up(tmp_path, "fixed") as flown:
        assert {event["event"] for event in flown.events()} == {"state"}
        assert all(_asked_by(flown, drone) for drone in DRONES)
        await flown.fleet.arm()
        commands = [event["command"] for event in flown.events() if event["event"] == "command"]
        assert commands == ["arm"]


def _asked_by(flown: Flown, drone: int) -> list[dict[str, Any]]:
    return flown.system.commanded(drone, SET_MESSAGE_INTERVAL)
