"""Clients that control nothing take neither room nor time from one that does (docs/gateway.md)."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Airframe, Arm, Armed, Disarm, Drone, Hold, SetParameter, Word
from mqttxt.gateway import control
from mqttxt.gateway.answers import Answers
from mqttxt.gateway.clients import Client
from mqttxt.gateway.desk import MOST_UNDER_WAY
from mqttxt.gateway.modes import PX4
from mqttxt.gateway.parameters import MOST_WAITING
from mqttxt.gateway.requests import MOST_OF_STRANGERS
from mqttxt.gateway.settings import MOST_OPEN
from mqttxt.gateway.telemetry import Turns
from mqttxt.gateway.translation import Request
from tests.rigs.loopback import eventually
from tests.simulation.desk import Bench

ACCEPTED, NOT_NOW, DENIED = range(3)
ARM = Request(400, (1.0, 0.0, None, None, None, None, None))
DISARM = Request(400, (0.0, 0.0, None, None, None, None, None))
LAND = Request(21, (None,) * 7)
HOLD = Request(176, (1.0, 4.0, 3.0, None, None, None, None))


def yaw(degrees: float) -> Request:
    return Request(115, (degrees, *[0.0] * 6))


def stranger(bench: Bench, name: str = "stranger") -> Client:
    """A client that has sent no HEARTBEAT yet."""
    made = bench.client(name, 200)
    bench.clients.on_gone(made.peer)
    return made


async def test_who_sends_no_heartbeat_takes_no_room_from_who_controls(bench: Bench) -> None:
    pilot, other = bench.client(), stranger(bench)
    await bench.ask(pilot, HOLD)
    for number in range(MOST_UNDER_WAY):
        await bench.ask(other, yaw(number))
    await bench.ask(pilot, yaw(7))
    await bench.ask(pilot, DISARM)
    assert [type(command).__name__ for command in bench.drone.commands] == ["Hold", "Mavlink", "Disarm"]


async def test_who_sends_no_heartbeat_takes_no_room_for_parameters_from_who_does(bench: Bench) -> None:
    bench.states = (Airframe(PX4, 2), Armed(False))
    pilot = bench.client()
    peer = stranger(bench).peer
    bench.drone.gate.clear()
    for number in range(MOST_WAITING):
        other, listed = Client(peer, 200, number % 200), mavlink.MAVLink_param_request_read_message(1, 1, b"", number)
        await bench.send(other, listed)
    for number in range(MOST_OPEN):
        await bench.send(Client(peer, 200, 1), mavlink.MAVLink_param_set_message(1, 1, b"A", float(number), 9))
    await bench.send(pilot, mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", 5.0, 9))
    assert bench.drone.commands == [SetParameter("MPC_XY_CRUISE", 5.0)]
    await bench.send(pilot, mavlink.MAVLink_param_request_read_message(1, 1, b"MPC_XY_CRUISE", -1))
    bench.drone.gate.set()
    await bench.settle()
    assert bench.of("PARAM_ERROR"), "an answer: the set has no such parameter"


async def test_a_full_drone_can_still_be_disarmed(bench: Bench) -> None:
    pilot = bench.client()
    for number in range(MOST_UNDER_WAY):
        await bench.ask(pilot, yaw(number))
    await bench.ask(pilot, DISARM)
    assert bench.drone.commands[-1] == Disarm()


async def test_who_sends_no_heartbeat_finds_bounded_room_until_it_does(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "HEARTBEAT_S", 0.5)
    other = stranger(bench)
    for number in range(MOST_OF_STRANGERS + 1):
        await bench.ask(other, yaw(number))
    assert bench.acks("stranger") == [(115, NOT_NOW)]
    third = stranger(bench, "third")
    await bench.ask(third, LAND)
    assert bench.acks("third") == [], "that socket has room of its own"
    await eventually(lambda: bench.acks("third"), "its answer")
    assert bench.acks("third") == [(21, DENIED)]
    bench.pass_time(10_100)
    bench.clients.on_heartbeat(third, bench.now_ms)
    await bench.ask(other, yaw(1))
    assert bench.acks("stranger")[-1] == (115, DENIED), "there is room again, and no HEARTBEAT waits long"


async def test_who_sends_no_heartbeat_ends_no_upload_of_who_did(bench: Bench) -> None:
    pilot, other = bench.client(), stranger(bench)
    begin = mavlink.MAVLink_mission_count_message(1, 1, 1, 0)
    item = mavlink.MAVLink_mission_item_int_message(1, 1, 0, 6, 16, 0, 1, 0, 0, 0, 0, 473_977_420, 85_455_940, 20.0, 0)
    await bench.send(pilot, begin)
    bench.pass_time(3100)
    await bench.send(other, begin)
    assert [ack.type for ack in bench.of("MISSION_ACK", "stranger")] == [mavlink.MAV_MISSION_DENIED]
    assert bench.texts("stranger") == [
        "mission upload: system 255 at qgc is uploading, and system 200 at stranger sends no HEARTBEAT"
    ]
    await bench.send(pilot, item)
    assert len(bench.drone.uploads) == 1


async def test_a_strangers_command_does_not_free_an_arm_from_its_hold(group: Any) -> None:
    """Nobody knows whether the drone holds: armed, it might fly its mission."""
    for request in (LAND, HOLD):
        bench = Bench(group)
        bench.states = (Airframe(PX4, 2), Armed(False))
        client, other = bench.client(), bench.client("other", 200)
        await bench.ask(client, HOLD)
        bench.pass_time(1000)
        await bench.ask(other, request)
        assert bench.acks("other") == [(request.mav_cmd, DENIED)]
        await bench.ask(client, ARM)
        assert bench.drone.commands == [Hold()]
        await bench.say(Word.ACCEPTED)
        assert bench.drone.commands == [Hold(), Arm()]


async def test_a_hold_of_who_sends_no_heartbeat_is_not_accepted_by_the_clock(bench: Bench) -> None:
    bench.states = (Airframe(PX4, 2), Armed(False))
    await bench.ask(stranger(bench), HOLD)
    bench.pass_time(1500)
    assert bench.acks("stranger") == []


async def test_a_client_that_is_gone_is_not_remembered(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control, "HEARTBEAT_S", 0.02)
    other = stranger(bench)
    await bench.ask(other, LAND)
    await asyncio.sleep(0.1)
    bench.pass_time(10_100)
    kept = [value for part in (bench.clients, bench.desk) for value in vars(part).values()]
    assert not any(other in value or (other, 1) in value for value in kept if isinstance(value, dict))


def seconds(handle: Callable[[Client], None], clients: list[Client]) -> float:
    began = time.process_time()
    for client in clients:
        handle(client)
    return time.process_time() - began


@pytest.mark.long
async def test_a_message_costs_no_more_the_more_clients_there_are(bench: Bench) -> None:
    peer, answers, view = bench.client().peer, Answers(Turns()), bench.view(None)
    sticks = mavlink.MAVLink_manual_control_message(1, 0, 0, 0, 0, 0)

    def command(client: Client) -> None:
        bench.clients.on_heartbeat(client, bench.now_ms)
        bench.desk.on_request(client, cast(Drone, bench.drone), LAND, 0, 10.0)

    def steer(client: Client) -> None:
        answers.on_message(sticks, client, view)

    clients = [Client(peer, system, component) for system in range(24) for component in range(250)]
    for handle in (command, steer):
        costs = [seconds(handle, clients[start : start + 500]) for start in range(0, len(clients), 500)]
        assert min(costs[-4:]) < 5 * max(costs[:2])
