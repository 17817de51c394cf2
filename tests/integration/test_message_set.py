"""The message set over both fleets: a real stand-in that is put back each time, real clients, brokers and MAVSDK."""

from __future__ import annotations

import json
import socket
from collections import Counter
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from mission.events import EventLog
from mission.fleet import CommandResult, MessageFleet, MissionError
from mission.mavsdk_messages import MavsdkMessageFleet
from mission.message_set import COMMANDS, STATES, MessageSet
from mission.mqttxt_messages import MqttxtMessageFleet
from mission.side_channel import SideChannel
from mqttxt.protocol.states import STATES as KNOWN
from tests.quick import LANDING, quick_fleet
from tests.rigs.processes import System, free_port, stand_in

pytestmark = [pytest.mark.integration, pytest.mark.apart]
OTHERS = pytest.mark.soak(
    *(f"services/mission/src/mission/{name}.py" for name in ("mavsdk_messages", "message_set", "mqttxt_messages"))
)
COUNT = 2
MAV_CMDS = {"arm": 400, "takeoff": 22, "land": 21, "offboard": 176, "goto": 192}
FIELDS = {name: set(KNOWN[name].__dataclass_fields__) - {"name"} for name in STATES}


@pytest.fixture
def autopilot(tmp_path: Path, streams: str) -> Iterator[int]:
    """A stand-in, and the port that it sends to."""
    port = free_port(socket.SOCK_DGRAM)
    sitl = stand_in(tmp_path, 1, port, "--streams", streams, fleet=quick_fleet(tmp_path, LANDING))
    try:
        sitl.start().wait_ready()
        yield port
    finally:
        sitl.kill()


class Deaf(SideChannel):
    """The side channel of an autopilot that never acknowledges a landing."""

    def listen(self, fleet: MessageFleet) -> None:
        call = fleet.call

        async def deaf(number: int, name: str) -> CommandResult:
            await self.set(mute=["COMMAND_ACK"] if name == "land" else [])
            result = await call(number, name)
            await self.set(mute=[])
            return result

        fleet.call = deaf  # type: ignore[method-assign]


async def _fly(folder: Path, fleet: MessageFleet, log: EventLog, count: int, deaf: bool = False) -> str | None:
    """Fly it; returns why it failed."""
    try:
        await fleet.connect(30)
        async with Deaf(folder / "sitl1.sock") as channel:
            if deaf:
                channel.listen(fleet)
            await MessageSet(fleet, log, channel, count).fly()
    except MissionError as error:
        return str(error)
    finally:
        await fleet.close()
        log.close()
    return None


def _events(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def _assert_all_are_there(folder: Path) -> None:
    """Ten kinds, COUNT of each; every call began where it was to begin, and had one outcome that accepts it first."""
    events = _events(folder / "events.jsonl")
    done = {e["name"]: (e["received"], e["missing"]) for e in events if e["event"] == "kind_done"}
    assert done == dict.fromkeys([*COMMANDS, *STATES], (COUNT, 0))
    assert all(event["followed"] for event in events if event["event"] == "reset")
    calls = [(e["call"], e["command"]) for e in events if e["event"] == "command"]
    assert calls == list(enumerate((name for name in COMMANDS for _ in range(COUNT)), 1))
    first = {e["call"]: e["word"] for e in reversed(events) if e["event"] == "outcome"}
    assert first == {call: "accepted" for call, _ in calls}
    values = [(e["name"], set(e["value"])) for e in events if e["event"] == "value"]
    assert values == [(name, FIELDS[name]) for name in STATES for _ in range(COUNT)]
    commanded = Counter(e["command"] for e in _events(folder / "sitl1.jsonl") if e["event"] == "command")
    assert {name: commanded[number] for name, number in MAV_CMDS.items() if name != "offboard"} == dict.fromkeys(
        ["arm", "takeoff", "land", "goto"], COUNT
    )
    holds = 3  # what ends it is a change of mode too, repeated every half second until a heartbeat shows it
    assert COUNT <= commanded[MAV_CMDS["offboard"]] <= (1 + holds) * COUNT
    modes = Counter(e["mode"] for e in _events(folder / "sitl1.jsonl") if e["event"] == "mode")
    assert {modes["takeoff"], modes["land"], modes["offboard"]} == {COUNT}


@pytest.mark.parametrize("states", ["bundle", pytest.param("on-change", marks=OTHERS)])
async def test_every_message_of_the_set_arrives_over_mqttxt(states: str, tmp_path: Path, system: System) -> None:
    log = EventLog(tmp_path / "events.jsonl", StringIO())
    fleet = MqttxtMessageFleet(system.cloud.url, {1: (1,)}, 1, log, states)
    assert await _fly(tmp_path, fleet, log, COUNT) is None
    _assert_all_are_there(tmp_path)
    words = [(e["word"], e["final"]) for e in _events(tmp_path / "events.jsonl") if e["event"] == "outcome"]
    assert len(words) == 2 * len(COMMANDS) * COUNT, "each call has a first word and a last one"


@pytest.mark.parametrize("streams", ["five-states", pytest.param("px4-onboard", marks=OTHERS)])
async def test_every_message_of_the_set_arrives_over_mavlink(streams: str, tmp_path: Path, autopilot: int) -> None:
    log = EventLog(tmp_path / "events.jsonl", StringIO())
    urls = (f"udpin://127.0.0.1:{autopilot}",)
    fleet = MavsdkMessageFleet(urls, {1: (1,)}, "one-by-one", streams, log)
    assert await _fly(tmp_path, fleet, log, COUNT) is None
    _assert_all_are_there(tmp_path)


def _assert_only_landing_failed(folder: Path, reason: str | None, word: str, why: str) -> None:
    assert reason == f"land: none of 1 (1 {word} ({why}))"
    events = _events(folder / "events.jsonl")
    done = {e["name"]: e["received"] for e in events if e["event"] == "kind_done"}
    assert done == dict.fromkeys([*COMMANDS, *STATES], 1) | {"land": 0}


async def test_a_call_that_is_not_acknowledged_is_counted_over_mqttxt(tmp_path: Path, system: System) -> None:
    log = EventLog(tmp_path / "events.jsonl", StringIO())
    reason = await _fly(tmp_path, MqttxtMessageFleet(system.cloud.url, {1: (1,)}, 1, log), log, 1, deaf=True)
    _assert_only_landing_failed(tmp_path, reason, "unconfirmed", "no_ack")


@OTHERS
@pytest.mark.parametrize("streams", ["five-states"])
async def test_a_call_that_is_not_acknowledged_is_counted_over_mavlink(
    streams: str, tmp_path: Path, autopilot: int
) -> None:
    log = EventLog(tmp_path / "events.jsonl", StringIO())
    urls = (f"udpin://127.0.0.1:{autopilot}",)
    fleet = MavsdkMessageFleet(urls, {1: (1,)}, "one-by-one", streams, log)
    reason = await _fly(tmp_path, fleet, log, 1, deaf=True)
    _assert_only_landing_failed(tmp_path, reason, "unconfirmed", "timeout")
