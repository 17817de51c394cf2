"""Commands that are wrong, late, retained, from a station without control, or enormous: each has its outcome."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import cbor2
import pytest
from paho.mqtt.client import MQTTMessage

from mqttxt import Arm, Goto, GroundStation, Word
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.messages import CommandMessage, FogResultMessage, ResultMessage
from tests.rigs import prefork
from tests.rigs.plain_client import plain_client
from tests.rigs.processes import Process, System, eventually

pytestmark = [pytest.mark.integration, pytest.mark.apart]

NAN, INFINITE = float("nan"), float("inf")
STRANGER = 77
"""The session of a station that never registered."""
ARM, TAKEOFF, REPOSITION = 400, 22, 192
"""MAV_CMDs."""

HEAD = [1, 5000, 100, 0]
"""Executor's session, deadline, limit and epoch, as they may be."""
BAD: list[tuple[list[Any], str]] = [
    ([1, 5000, "soon", 0, 1], "limit_s: expected a whole number from 1 to 864000, got 'soon'"),
    ([1, 5000, 0, 0, 1], "limit_s: expected a whole number from 1 to 864000, got 0"),
    ([1, -1, 100, 0, 1], "deadline_ms: expected a whole number from 0 to"),
    ([1, 5000, 100, -1, 1], "epoch: expected a whole number"),
    ([*HEAD, 99], "command: expected a known command, got 99"),
    ([*HEAD, "arm"], "command: expected a known command, got 'arm'"),
    ([*HEAD, 1, 1], "expected at most 0 fields"),
    ([*HEAD, 3], "altitude_m: expected a value"),
    ([*HEAD, 3, NAN], "altitude_m: expected a whole number from 500 to 10000000, got nan"),
    ([*HEAD, 3, 10_000_001], "altitude_m: expected a whole number from 500 to 10000000"),
    ([*HEAD, 5, NAN, 0, 0], "latitude_deg: expected a whole number from -900000000 to 900000000, got nan"),
    ([*HEAD, 5, 900_000_001, 0, 0], "latitude_deg: expected a whole number from -900000000 to"),
    ([*HEAD, 5, 0, 1_800_000_001, 0], "longitude_deg: expected a whole number from -1800000000 to"),
    ([*HEAD, 5, 0, 0, INFINITE], "altitude_m: expected a whole number from -500000 to"),
    ([*HEAD, 5, 0, 0, True], "altitude_m: expected a whole number from -500000 to 10000000, got True"),
    ([*HEAD, 8, 0, [100, 0, 0]], "duration_s: expected a whole number from 1 to 36000, got 0"),
    ([*HEAD, 8, NAN, [100, 0, 0]], "duration_s: expected a whole number from 1 to 36000, got nan"),
    ([*HEAD, 8, 100, [NAN, 0, 0]], "north_m_s: expected a whole number from -10000 to 10000, got nan"),
    ([*HEAD, 8, 100, [10_001, 0, 0]], "north_m_s: expected a whole number from -10000 to 10000, got 10001"),
]
BAD_JSON: list[tuple[dict[str, Any], str]] = [
    ({"version": 2, "command": "arm"}, "version: expected 1, got 2"),
    ({"command": "explode"}, "command: expected a known command, got 'explode'"),
    ({"command": "takeoff", "altitude_m": NAN}, "expected a number, got NaN"),
    ({"command": "takeoff", "altitude_m": "high"}, "altitude_m: expected a number from 0.5 to 10000, got 'high'"),
    ({"command": "takeoff", "altitude_m": 10, "speed": 3}, "expected fields of Takeoff, got ['speed']"),
    ({"command": "goto", "latitude_deg": 91, "longitude_deg": 0, "altitude_m": 1}, "latitude_deg: expected a number"),
]


class Answers:
    """The word and reason of each command, by its station's session and its number."""

    def __init__(self) -> None:
        self.heard: dict[tuple[int, int], tuple[Word, str]] = {}

    def has(self, count: int) -> bool:
        return len(self.heard) == count

    def take(self, message: MQTTMessage) -> None:
        if "/drone" in f"/{message.topic}":
            said = decode(ResultMessage, message.payload)
            self.heard[said.gs_session, said.seq] = (said.word, said.reason or "")
        else:
            answer = decode(FogResultMessage, message.payload)
            self.heard[answer.gs_session, answer.seq] = (Word.DENIED, answer.denied or "")


def malformed(session: int) -> list[tuple[bytes, str]]:
    """Each bad command with a number of its own, and what its denial says."""
    found = []
    for seq, (rest, said) in enumerate(BAD):
        found.append((cbor2.dumps([1, session, seq, *rest]), said))
    plain = {
        "version": 1,
        "gs_session": session,
        "executor_session": 1,
        "deadline_ms": 5000,
        "limit_s": 10,
        "epoch": 0,
    }
    for seq, (changed, said) in enumerate(BAD_JSON, start=len(BAD)):
        found.append((json.dumps({**plain, "seq": seq, **changed}).encode(), said))
    return found


async def test_every_malformed_command_is_denied_with_its_field_by_whoever_gets_it(system: System) -> None:
    ways = (
        (system.cloud.port, "fog1/drone1/commands", "fog1/drone1/commands_result/#"),
        (system.fog.port, "drone1/commands", "drone1/commands_result/#"),
        (system.cloud.port, "fog1/commands", "fog1/commands_result/#"),
    )
    for session, (port, topic, results) in enumerate(ways, start=STRANGER):  # an id is answered once a second
        cases, answers = malformed(session), Answers()
        with plain_client(port, results, heard=answers.take) as client:
            for payload, _ in cases:
                client.publish(topic, payload, qos=1)
            await eventually(partial(answers.has, len(cases)), f"an answer to each on {results}")
        for seq, (_, said) in enumerate(cases):
            word, reason = answers.heard[session, seq]
            assert word is Word.DENIED
            assert said in reason
    assert [system.commanded(1, number) for number in (ARM, TAKEOFF, REPOSITION)] == [[], [], []]


async def test_well_formed_commands_that_may_not_be_executed_are_denied_with_the_reason(system: System) -> None:
    async with GroundStation(system.cloud.url, name="alpha") as station:
        (fog,) = await station.connect([1])
        await eventually(lambda: fog.drone(1).is_reachable, "drone 1 is reachable")
        inside = station._runner
        executor = inside.station.fogs[1].session
        assert executor is not None
        common = {"executor_session": executor, "deadline_ms": 10**9, "limit_s": 10.0, "command": Arm()}
        clock = inside.station.fogs[1].clock
        assert clock is not None
        soon = clock.deadline_ms(inside.clock.now_ms(), 20_000)
        cases: list[tuple[str, dict[str, Any], bool, str, str]] = [
            ("drone1/commands", {"deadline_ms": None}, False, "denied", "no_deadline"),
            ("drone1/commands", {"executor_session": 0}, False, "denied", "no_deadline"),
            ("drone1/commands", {}, False, "denied", "deadline_too_far"),
            ("drone1/commands", {"deadline_ms": 1}, False, "expired", ""),
            ("drone1/commands", {"deadline_ms": soon}, True, "denied", "retained"),
            ("drone1/commands", {"deadline_ms": soon}, False, "denied", "not_in_control, alpha"),
            ("drone9/commands", {"deadline_ms": soon}, False, "unreachable", ""),
            ("commands", {"deadline_ms": soon, "command": Goto(47.0, 8.0, 10.0)}, False, "denied", "not_broadcastable"),
        ]
        answers, results = Answers(), ("fog1/+/commands_result/#", "fog1/commands_result/#")
        with plain_client(system.cloud.port, *results, heard=answers.take) as client:
            for seq, (rest, changed, retained, _, _) in enumerate(cases):
                message = CommandMessage(gs_session=STRANGER, seq=seq, **{**common, **changed})
                client.publish(f"fog1/{rest}", encode(message), qos=1, retain=retained)
            await eventually(partial(answers.has, len(cases)), "an answer to each")
            client.publish("fog1/drone1/commands", b"", qos=1, retain=True)
        for seq, (_, _, _, word, reason) in enumerate(cases):
            said, why = answers.heard[STRANGER, seq]
            assert (said.label, why) == (word, reason), cases[seq]
    assert system.commanded(1, ARM) == []


async def test_a_station_that_is_not_in_control_is_told_who_is(system: System) -> None:
    async with (
        GroundStation(system.cloud.url, name="alpha") as holder,
        GroundStation(system.cloud.url, name="beta", control=False) as watcher,
    ):
        (fog,) = await holder.connect([1])
        (seen,) = await watcher.connect([1])
        await eventually(lambda: seen.drone(1).is_reachable and fog.drone(1).is_reachable, "drone 1 is reachable")
        denied = await seen.drone(1).send(Arm())
        assert (denied.word, denied.reason) == (Word.DENIED, "not_in_control, alpha")
        where = ["--drone", "1", "--cloud", system.cloud.url]
        told = await asyncio.to_thread(prefork.run, "mqttxt", "gs", "send", "arm", *where)
        assert told.returncode == 1
        assert told.stdout.startswith("drone 1: arm denied(not_in_control, alpha). ")
        assert told.stdout.endswith("--take-over takes control from it.\n")
        assert (await fog.drone(1).arm()).completed
    assert len(system.commanded(1, ARM)) == 1


PUBLISH_256_MB = """
import sys
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
client.connect("127.0.0.1", int(sys.argv[1]), 600)
client.loop_start()
client.publish(sys.argv[2], bytes(256_000_000), qos=1).wait_for_publish(100)
client.disconnect()
"""
MOST_MEMORY_KB = 120_000


def peak_memory_kb(process: Process) -> int:
    """The most resident memory that a process ever had (VmHWM, proc(5))."""
    for line in Path(f"/proc/{process.pid}/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1])
    raise AssertionError("no VmHWM")


@pytest.mark.soak("services/mqttxt/src/mqttxt/core")
@pytest.mark.timeout(400)  # a gigabyte in all, on a machine that has other things to do
async def test_a_payload_of_256_mb_reaches_no_role(system: System) -> None:
    """The broker takes it; it is told by each role that packets this large are not for it."""
    targets = [
        (system.cloud.port, "fog1/commands"),
        (system.cloud.port, "fog1/drone1/commands_result/arm"),
        (system.fog.port, "drone1/commands"),
        (system.fog.port, "drone1/states"),
    ]
    async with GroundStation(system.cloud.url) as station:
        (fog,) = await station.connect([1])
        for port, topic in targets:
            command = [sys.executable, "-c", PUBLISH_256_MB, str(port), topic]
            done = await asyncio.to_thread(subprocess.run, command, timeout=90, capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
        assert (await fog.drone(1).arm()).completed
    roles = (system.activator, *system.uavs.values())
    assert [role.exit_code for role in roles] == [None] * 3
    assert all(peak_memory_kb(role) < MOST_MEMORY_KB for role in roles), [peak_memory_kb(role) for role in roles]
