"""What depends on whether a drone is armed: HOLD before arming, and takeoffs that wait for an arm."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from mqttxt import Airframe, Arm, Armed, Drone, Hold, Home, Stream, Takeoff, Word
from mqttxt.gateway import control
from mqttxt.gateway.arming import HEARD_MS
from mqttxt.gateway.clients import Client
from mqttxt.gateway.modes import PX4
from mqttxt.gateway.translation import Request
from tests.simulation.desk import Bench

ACCEPTED, NOT_NOW, DENIED = range(3)
ARM = Request(400, (1.0, 0.0, None, None, None, None, None))
TAKEOFF = Request(22, (None,) * 7)
LAND = Request(21, (None,) * 7)
HOLD = Request(176, (1.0, 4.0, 3.0, None, None, None, None))


def disarmed(group: Any, **how: Any) -> Bench:
    made = Bench(group, **how)
    made.states = (Airframe(PX4, 2), Armed(False), Home(47.0, 8.0, 488.0))
    return made


async def is_accepted_by_the_clock(bench: Bench, client: Client) -> bool:
    """Ask for HOLD, and see whether it is ACCEPTED without a word of the drone."""
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.ask(client, HOLD)
    assert bench.drone.commands[-1] == Hold()
    before = len(bench.acks())
    bench.pass_time(1100)
    return (176, ACCEPTED) in bench.acks()[before:]


# HOLD before arming


async def test_a_hold_behind_an_arm_and_a_takeoff_waits_for_the_drones_word(group: Any) -> None:
    """On a far link the state still says disarmed when the word is here that it is not."""
    bench = disarmed(group)
    client = bench.client()
    for request in (ARM, TAKEOFF):
        await bench.ask(client, request)
        await bench.say(Word.ACCEPTED)
        await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm(), Takeoff(10.0)]
    assert not await is_accepted_by_the_clock(bench, client)


@pytest.mark.parametrize("word", [None, Word.ACCEPTED, Word.UNCONFIRMED])
async def test_a_hold_behind_an_arm_whose_end_is_not_known_waits_for_the_drones_word(
    group: Any, word: Word | None
) -> None:
    bench = disarmed(group)
    client = bench.client()
    await bench.ask(client, ARM)
    if word is not None:
        await bench.say(word)
    bench.pass_time(500 if word is not Word.UNCONFIRMED else 0)
    assert not await is_accepted_by_the_clock(bench, client)


async def test_a_hold_behind_an_arm_that_was_denied_or_has_ended_since_is_accepted_by_the_clock(group: Any) -> None:
    for word, pause_ms in ((Word.DENIED, 0), (Word.COMPLETED, 2000)):
        bench = disarmed(group)
        client = bench.client()
        await bench.ask(client, ARM)
        await bench.say(word)
        bench.pass_time(pause_ms)
        assert await is_accepted_by_the_clock(bench, client), "a state that is newer says disarmed"


async def test_a_hold_of_a_drone_that_is_not_heard_waits_for_its_word(group: Any) -> None:
    for age_ms, is_reachable, by_the_clock in (
        (HEARD_MS, True, True),
        (HEARD_MS + 1, True, False),
        (None, True, False),
        (0, False, False),
    ):
        bench = disarmed(group)
        bench.age_ms, bench.drone.is_reachable = age_ms, is_reachable
        assert await is_accepted_by_the_clock(bench, bench.client()) == by_the_clock


# Takeoff before arming


@pytest.mark.parametrize("is_gone", [True, False])
async def test_a_kept_takeoff_is_not_flown_for_a_client_that_is_gone_when_the_arm_is_completed(
    group: Any, monkeypatch: pytest.MonkeyPatch, is_gone: bool
) -> None:
    monkeypatch.setattr(control, "HEARTBEAT_S", 0.02)
    bench = disarmed(group)
    client = bench.client()
    for request in (TAKEOFF, ARM):
        await bench.ask(client, request)
    await bench.say(Word.ACCEPTED)
    if is_gone:
        bench.clients.on_gone(client.peer)
    else:
        bench.pass_time(6000)
    bench.control.review(cast(Drone, bench.drone), Armed(False))
    await bench.say(Word.COMPLETED)
    await asyncio.sleep(0.1)
    await bench.settle()
    assert (bench.drone.commands, bench.drone.wanted) == ([Arm()], False)


async def test_a_kept_takeoff_waits_for_its_clients_heartbeat(group: Any) -> None:
    bench = disarmed(group)
    client = bench.client()
    for request in (TAKEOFF, ARM):
        await bench.ask(client, request)
    bench.pass_time(3100)
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm()]
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.settle()
    assert bench.drone.commands == [Arm(), Takeoff(10.0)]


async def test_a_kept_takeoff_is_not_flown_for_a_client_that_has_lost_control(group: Any) -> None:
    bench = disarmed(group)
    client, other = bench.client(), bench.client("safety", 245)
    for request in (TAKEOFF, ARM):
        await bench.ask(client, request)
    await bench.ask(other, Request(32100, (1.0, 1.0, *[0.0] * 5)))
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm()]
    assert bench.texts()[-1] == "takeoff given up: its client has lost control"


async def test_a_takeoff_behind_an_arm_is_not_flown_for_a_client_that_is_silent(
    group: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "HEARTBEAT_S", 0.02)
    bench = disarmed(group)
    client = bench.client()
    for request in (ARM, TAKEOFF):
        await bench.ask(client, request)
    bench.pass_time(3100)
    await bench.say(Word.COMPLETED)
    await asyncio.sleep(0.1)
    await bench.settle()
    assert (bench.drone.commands, bench.acks()[-1]) == ([Arm()], (22, DENIED))


@pytest.mark.parametrize("altitude_m", [50_000.0, 0.3, float("inf")])
async def test_a_takeoff_to_an_altitude_that_no_takeoff_has_is_denied_and_not_kept(
    group: Any, altitude_m: float
) -> None:
    bench = disarmed(group)
    client = bench.client()
    await bench.ask(client, Request(22, (*[None] * 6, 488.0 + altitude_m)))
    assert bench.acks() == [(22, DENIED)]
    assert "expected a number from 0.5 to 10000" in bench.texts()[0]
    await bench.ask(client, ARM)
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm()]


async def test_a_strangers_command_does_not_give_a_kept_takeoff_up(group: Any) -> None:
    bench = disarmed(group)
    client, stranger = bench.client(), bench.client("stranger", 200)
    await bench.ask(client, TAKEOFF)
    bench.clients.controllers[1] = client
    await bench.ask(stranger, LAND)
    assert bench.acks("stranger") == [(21, DENIED)]
    await bench.ask(client, ARM)
    await bench.ask(stranger, LAND)
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm(), Takeoff(10.0)]


# What flies nothing, beside what waits


STREAM = Request(511, (30.0, 100_000.0, 0.0, 0.0, 0.0, 0.0, 0.0))


async def test_a_stream_gives_up_no_takeoff_that_waits_behind_an_arm(group: Any) -> None:
    bench = disarmed(group)
    client = bench.client()
    bench.clients.on_heartbeat(client, bench.now_ms)
    for request in (ARM, TAKEOFF, STREAM):
        await bench.ask(client, request)
    await bench.say(Word.ACCEPTED, 0)
    await bench.say(Word.COMPLETED, 0)
    assert [type(command) for command in bench.drone.commands if not isinstance(command, Stream)] == [Arm, Takeoff]
