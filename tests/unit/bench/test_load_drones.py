"""The light autopilot and the schedule of the drones of a load, on a broker that is not there."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.core.effects import Inbound, Publish, Subscribe
from mqttxt.core.settings import Settings
from mqttxt.drone.commands import LINK
from mqttxt.drone.mavlink.sources import Source
from mqttxt.drone.role import UavClient
from mqttxt.protocol.bundles import DroneBundle
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm
from mqttxt.protocol.topics import FogSide
from tests.bench.fleet import FIVE
from tests.bench.load_drones import PARTS, STEADY, TICKS_PER_S, LightAutopilot, LightRunner, turn
from tests.simulation.world import command_payload

NOWHERE = BrokerAddress.parse("mqtt://127.0.0.1:1")


def kinds(messages: list[Any]) -> list[str]:
    return [message.get_type() for message in messages]


def arming(value: float) -> Any:
    return mavlink.MAVLink_command_long_message(3, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, value, *[0] * 6)


def test_an_autopilot_says_something_else_each_second() -> None:
    autopilot = LightAutopilot(3)
    said = [autopilot.beat() for _ in range(4)]
    assert all(kinds(one)[:3] == ["HEARTBEAT", "GLOBAL_POSITION_INT", "VFR_HUD"] for one in said)
    assert len({(one[1].lat, one[1].lon, one[1].hdg, one[2].groundspeed) for one in said}) == 4
    assert sum("BATTERY_STATUS" in kinds(one) and "EXTENDED_SYS_STATE" in kinds(one) for one in said) == 2
    assert {message.get_srcSystem() for one in said for message in one} == {3}


def test_an_autopilot_arms_when_told_to_and_notes_it() -> None:
    autopilot = LightAutopilot(3)
    before_s = time.monotonic()
    ack, heartbeat = autopilot.take(arming(1), Source.COMPANION)
    assert (ack.command, ack.result) == (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_RESULT_ACCEPTED)
    assert heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    (command, at_s) = autopilot.commanded[0]
    assert command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    assert before_s <= at_s <= time.monotonic()
    assert not autopilot.take(arming(0), Source.COMPANION)[1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_five_states_leave_each_second_though_a_turn_comes_late() -> None:
    client = UavClient(3, 77, Settings(bundles=True), FogSide(), {state.name: STEADY for state in FIVE})
    autopilot = LightAutopilot(3)
    client.on_connected(LINK, 0)
    for _ in range(2):
        client.on_subscribed(Subscribe(LINK, ("x",)), 0)
    bundles = []
    for second in range(10):
        for message in autopilot.beat():
            client.on_mavlink(message, 1000 * second)
        for tenth in range(10):
            late_ms = 90 if second % 2 == 0 else 0
            out = client.tick(1000 * second + 100 * tenth + late_ms)
            bundles += [e for e in out if isinstance(e, Publish) and e.topic == "drone3/states"]
    names = [{one.state.name for one in decode(DroneBundle, bundle.payload).states} for bundle in bundles]
    assert sum({state.name for state in FIVE} <= found for found in names) >= 9


@pytest.mark.long
async def test_every_runner_is_called_ten_times_a_second_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[int] = []
    monkeypatch.setattr(LightRunner, "turn", lambda runner: called.append(runner.client.drone))
    runners = [LightRunner(drone, NOWHERE, "fog1/") for drone in range(1, 2 * PARTS + 1)]
    turning = asyncio.create_task(turn(runners))
    await asyncio.sleep(1.0)
    turning.cancel()
    counts = {drone: called.count(drone) for drone in range(1, 2 * PARTS + 1)}
    assert max(counts.values()) - min(counts.values()) <= 1
    assert min(counts.values()) >= 1
    assert max(counts.values()) <= TICKS_PER_S + 1


async def test_a_command_is_told_to_the_autopilot_once_however_late_the_next_turn_comes() -> None:
    now_ms = 0
    runner = LightRunner(3, NOWHERE, "fog1/")
    runner.clock = SessionClock(lambda: now_ms * 1_000_000, runner.clock.session)
    runner.turn()
    runner.client.on_connected(LINK, 0)
    for _ in range(2):
        runner.subscribed(Subscribe(LINK, ("x",)))
    command = command_payload(Arm(), executor_session=runner.clock.session)
    runner.received(LINK, Inbound("fog1/drone3/commands", encode(command), 1))
    now_ms = 2000
    runner.turn()
    now_ms = 4000
    runner.turn()
    assert [mav_cmd for mav_cmd, _ in runner.autopilot.commanded] == [mavlink.MAV_CMD_COMPONENT_ARM_DISARM]


async def test_a_runner_hears_its_autopilot_before_the_first_turn_is_over() -> None:
    runner = LightRunner(3, NOWHERE, "fog1/")
    runner.turn()
    assert runner.client.vehicle.is_alive(runner.clock.now_ms())
