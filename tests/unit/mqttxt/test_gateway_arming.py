"""What depends on whether a drone is armed: HOLD before arming, and takeoffs that wait for an arm (docs/gateway.md)."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from mqttxt import Airframe, Arm, Armed, Disarm, Drone, Hold, Home, Land, Return, Stream, Takeoff, Word
from mqttxt.gateway import control
from mqttxt.gateway.arming import HEARD_MS
from mqttxt.gateway.clients import Client
from mqttxt.gateway.modes import PX4
from mqttxt.gateway.translation import REQUEST_OPERATOR_CONTROL, Request
from tests.simulation.desk import Bench

ACCEPTED, NOT_NOW, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS, CANCELLED = range(7)
ARM = Request(400, (1.0, 0.0, None, None, None, None, None))
DISARM = Request(400, (0.0, 0.0, None, None, None, None, None))
TAKEOFF = Request(22, (None,) * 7)
LAND = Request(21, (None,) * 7)
HOLD = Request(176, (1.0, 4.0, 3.0, None, None, None, None))
RETURN = Request(176, (1.0, 4.0, 5.0, None, None, None, None))
TAKE = Request(REQUEST_OPERATOR_CONTROL, (1.0, 1.0, 10.0, 255.0, 0.0, 0.0, 0.0))


def disarmed(group: Any, **how: Any) -> Bench:
    made = Bench(group, **how)
    made.states = (Airframe(PX4, 2), Armed(False), Home(47.0, 8.0, 488.0))
    return made


async def ask(bench: Bench, client: Client, *requests: Request) -> None:
    for request in requests:
        await bench.ask(client, request)


@pytest.fixture
def bench(group: Any) -> Bench:
    return disarmed(group)


async def is_accepted_by_the_clock(bench: Bench, client: Client) -> bool:
    """Ask for HOLD, and see whether it is ACCEPTED without a word of the drone."""
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.ask(client, HOLD)
    assert bench.drone.commands[-1] == Hold()
    before = len(bench.acks())
    bench.pass_time(1100)
    return (176, ACCEPTED) in bench.acks()[before:]


# HOLD before arming


async def test_a_hold_before_arming_is_accepted_within_a_second_and_the_arm_waits_for_it(
    bench: Bench, client: Client
) -> None:
    """MAVSDK's arm() enters HOLD first behind a mission; its process ends where that is not accepted within 2 s."""
    await bench.ask(client, HOLD)
    bench.pass_time(950)
    assert bench.acks() == []
    bench.pass_time(50)
    assert bench.acks() == [(176, ACCEPTED)]
    await bench.ask(client, ARM)
    bench.pass_time(500)
    assert (bench.acks()[1:], bench.drone.commands) == ([(400, IN_PROGRESS)], [Hold()])
    await bench.say(Word.ACCEPTED)
    assert bench.drone.commands == [Hold(), Arm()]
    await bench.say(Word.COMPLETED, 0)
    await bench.say(Word.ACCEPTED)
    assert (bench.acks()[2:], bench.texts()) == ([(400, ACCEPTED)], ["hold completed"])


@pytest.mark.parametrize("word", [Word.EXPIRED, Word.UNCONFIRMED, Word.DENIED])
async def test_a_drone_that_did_not_hold_before_arming_is_not_armed(bench: Bench, client: Client, word: Word) -> None:
    """It might fly the mission in whose mode it still is."""
    await bench.ask(client, HOLD)
    bench.pass_time(1000)
    await bench.ask(client, ARM)
    await bench.say(word)
    assert bench.acks() == [(176, ACCEPTED), (400, NOT_NOW)]
    assert (bench.texts()[1:], bench.drone.commands) == (["not armed: the drone did not hold first"], [Hold()])
    await ask(bench, client, RETURN, ARM)
    assert bench.drone.commands[1:] == [Return(), Arm()], "what was commanded since counts"


async def test_of_a_hold_before_arming_that_others_command_an_arm_does_not_wait(group: Any) -> None:
    bench = disarmed(group, take_over=True)
    await bench.ask(bench.client(), HOLD)
    await bench.ask(bench.client("mavsdk", 245), ARM)
    assert bench.drone.commands == [Hold(), Arm()]


async def test_a_hold_of_a_client_that_is_not_alive_keeps_no_arm_waiting(
    bench: Bench, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "HEARTBEAT_S", 0.01)
    bench.now_ms += 5000
    await ask(bench, client, HOLD, ARM)
    async with asyncio.timeout(5):
        while len(bench.acks()) < 2:
            await asyncio.sleep(0.01)
    assert bench.acks() == [(176, DENIED), (400, DENIED)]


async def test_a_hold_behind_an_arm_and_a_takeoff_waits_for_the_drones_word(bench: Bench, client: Client) -> None:
    """On a far link the state still says disarmed when the word is here that it is not."""
    for request in (ARM, TAKEOFF):
        await bench.ask(client, request)
        await bench.say(Word.ACCEPTED)
        await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm(), Takeoff(10.0)]
    assert not await is_accepted_by_the_clock(bench, client)


@pytest.mark.parametrize("word", [None, Word.ACCEPTED, Word.UNCONFIRMED])
async def test_a_hold_behind_an_arm_whose_end_is_not_known_waits_for_the_drones_word(
    bench: Bench, client: Client, word: Word | None
) -> None:
    await bench.ask(client, ARM)
    if word is not None:
        await bench.say(word)
    bench.pass_time(500 if word is not Word.UNCONFIRMED else 0)
    assert not await is_accepted_by_the_clock(bench, client)


@pytest.mark.parametrize(("word", "pause_ms"), [(Word.DENIED, 0), (Word.COMPLETED, 2000)])
async def test_a_hold_behind_an_arm_that_was_denied_or_has_ended_since_is_accepted_by_the_clock(
    bench: Bench, client: Client, word: Word, pause_ms: int
) -> None:
    await bench.ask(client, ARM)
    await bench.say(word)
    bench.pass_time(pause_ms)
    assert await is_accepted_by_the_clock(bench, client), "a state that is newer says disarmed"


@pytest.mark.parametrize(
    ("age_ms", "is_reachable", "by_the_clock"),
    [(HEARD_MS, True, True), (HEARD_MS + 1, True, False), (None, True, False), (0, False, False)],
)
async def test_a_hold_of_a_drone_that_is_not_heard_waits_for_its_word(
    bench: Bench, client: Client, age_ms: int | None, is_reachable: bool, by_the_clock: bool
) -> None:
    bench.age_ms, bench.drone.is_reachable = age_ms, is_reachable
    assert await is_accepted_by_the_clock(bench, client) == by_the_clock


# Takeoff before arming


async def test_a_takeoff_waits_for_its_clients_arming(bench: Bench, client: Client) -> None:
    await bench.ask(client, TAKEOFF)
    assert (bench.acks(), bench.drone.sent) == ([(22, ACCEPTED)], [])
    await bench.ask(client, ARM)
    await bench.say(Word.ACCEPTED)
    assert bench.drone.commands == [Arm()]
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm(), Takeoff(10.0)]
    await bench.say(Word.ACCEPTED)
    await bench.say(Word.COMPLETED)
    assert bench.acks() == [(22, ACCEPTED), (400, ACCEPTED)]
    assert bench.texts()[1:] == ["arm completed", "takeoff completed"]


async def test_a_takeoff_right_behind_an_arm_waits_for_it_and_flies(bench: Bench, client: Client) -> None:
    """MAVSDK's arm() returns once that is accepted, and takeoff() comes before a heartbeat shows the drone armed."""
    await bench.ask(client, ARM)
    await bench.say(Word.ACCEPTED)
    await bench.ask(client, TAKEOFF)
    assert bench.drone.commands == [Arm()]
    bench.pass_time(500)
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm(), Takeoff(10.0)]
    await bench.say(Word.ACCEPTED)
    assert bench.acks() == [(400, ACCEPTED), (22, IN_PROGRESS), (22, ACCEPTED)]


async def test_behind_an_arm_that_fails_a_takeoff_is_denied_by_the_drone(bench: Bench, client: Client) -> None:
    await ask(bench, client, ARM, TAKEOFF)
    await bench.say(Word.DENIED)
    await bench.say(Word.DENIED, reason="disarmed")
    assert bench.drone.commands == [Arm(), Takeoff(10.0)]
    assert bench.acks() == [(400, DENIED), (22, DENIED)]


async def test_a_takeoff_behind_an_arm_is_given_up_for_a_newer_command(bench: Bench, client: Client) -> None:
    await ask(bench, client, ARM, TAKEOFF, LAND)
    await bench.say(Word.COMPLETED, 0)
    assert bench.drone.commands == [Arm(), Land()]
    assert bench.acks() == [(400, ACCEPTED), (22, CANCELLED)]


async def test_an_arm_that_was_completed_counts_for_more_than_an_older_state(bench: Bench, client: Client) -> None:
    for wait_ms, flies in ((100, True), (3100, False)):
        bench.drone.sent.clear()
        bench.pass_time(2000)
        bench.clients.on_heartbeat(client, bench.now_ms)
        await bench.ask(client, ARM)
        await bench.say(Word.COMPLETED)
        bench.pass_time(wait_ms)
        bench.clients.on_heartbeat(client, bench.now_ms)
        await bench.ask(client, TAKEOFF)
        assert (Takeoff(10.0) in bench.drone.commands) == flies


async def test_a_takeoff_that_nobody_arms_for_is_given_up(bench: Bench, client: Client) -> None:
    await bench.ask(client, TAKEOFF)
    bench.pass_time(10_100)
    assert "given up" in bench.texts()[-1]
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.ask(client, ARM)
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm()]


async def test_another_clients_arming_or_another_command_gives_a_kept_takeoff_up(group: Any) -> None:
    for other, request in (("script", ARM), ("qgc", LAND)):
        bench = disarmed(group, take_over=True)
        client = bench.client()
        await bench.ask(client, TAKEOFF)
        await bench.ask(client if other == "qgc" else bench.client(other, 245), request)
        await bench.say(Word.COMPLETED)
        await bench.ask(client, ARM)
        await bench.say(Word.COMPLETED)
        assert Takeoff(10.0) not in bench.drone.commands


async def test_a_command_during_the_arming_gives_the_takeoff_up(bench: Bench, client: Client) -> None:
    await ask(bench, client, TAKEOFF, ARM, DISARM)
    await bench.say(Word.COMPLETED, 0)
    assert bench.drone.commands == [Arm(), Disarm()]
    assert bench.texts()[-1] == "takeoff given up: another command came"


async def test_after_a_stall_no_takeoff_follows_its_arm(bench: Bench, client: Client) -> None:
    """The machine was suspended, and the word of the arm is asked for an hour later."""
    await ask(bench, client, TAKEOFF, ARM)
    bench.desk.on_stall()
    await bench.say(Word.COMPLETED)
    assert (bench.drone.commands, bench.texts()[-1]) == ([Arm()], "takeoff given up: the gateway stood still")


async def test_after_a_stall_no_arm_follows_its_hold(bench: Bench, client: Client) -> None:
    await ask(bench, client, HOLD, ARM)
    bench.desk.on_stall()
    await bench.say(Word.ACCEPTED)
    assert (bench.drone.commands, bench.acks()[-1]) == ([Hold()], (400, NOT_NOW))


async def test_where_the_arming_fails_there_is_no_takeoff(bench: Bench, client: Client) -> None:
    await ask(bench, client, TAKEOFF, ARM)
    await bench.say(Word.DENIED, reason="autopilot: no GPS")
    assert bench.drone.commands == [Arm()]
    assert bench.texts()[-1] == "takeoff given up: the drone is not armed"


async def test_a_takeoff_behind_an_arm_does_not_take_the_drone_back_from_another_station(group: Any) -> None:
    bench = disarmed(group, take_over=True)
    client = bench.client()
    await ask(bench, client, TAKEOFF, ARM)
    await bench.taken()
    await bench.say(Word.COMPLETED)
    assert (bench.drone.commands, bench.drone.is_controlled) == ([Arm()], False)
    assert bench.texts()[-1] == "takeoff given up: another command came"


async def test_a_takeoff_that_waits_for_an_arm_is_given_up_where_another_station_takes_the_drone(group: Any) -> None:
    bench = disarmed(group, take_over=True)
    client = bench.client()
    await bench.ask(client, TAKEOFF)
    await bench.taken()
    await bench.ask(client, ARM)
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm()]


@pytest.mark.parametrize("is_gone", [True, False])
async def test_a_kept_takeoff_is_not_flown_for_a_client_that_is_gone_when_the_arm_is_completed(
    bench: Bench, client: Client, monkeypatch: pytest.MonkeyPatch, is_gone: bool
) -> None:
    monkeypatch.setattr(control, "HEARTBEAT_S", 0.02)
    await ask(bench, client, TAKEOFF, ARM)
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


async def test_a_kept_takeoff_waits_for_its_clients_heartbeat(bench: Bench, client: Client) -> None:
    await ask(bench, client, TAKEOFF, ARM)
    bench.pass_time(3100)
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm()]
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.settle()
    assert bench.drone.commands == [Arm(), Takeoff(10.0)]


async def test_a_kept_takeoff_is_not_flown_for_a_client_that_has_lost_control(bench: Bench) -> None:
    client, other = bench.client(), bench.client("safety", 245)
    await ask(bench, client, TAKEOFF, ARM)
    await bench.ask(other, TAKE)
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm()]
    assert bench.texts()[-1] == "takeoff given up: its client has lost control"


async def test_a_takeoff_behind_an_arm_is_not_flown_for_a_client_that_is_silent(
    bench: Bench, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "HEARTBEAT_S", 0.02)
    await ask(bench, client, ARM, TAKEOFF)
    bench.pass_time(3100)
    await bench.say(Word.COMPLETED)
    await asyncio.sleep(0.1)
    await bench.settle()
    assert (bench.drone.commands, bench.acks()[-1]) == ([Arm()], (22, DENIED))


@pytest.mark.parametrize("altitude_m", [50_000.0, 0.3, float("inf")])
async def test_a_takeoff_to_an_altitude_that_no_takeoff_has_is_denied_and_not_kept(
    bench: Bench, client: Client, altitude_m: float
) -> None:
    await bench.ask(client, Request(22, (*[None] * 6, 488.0 + altitude_m)))
    assert bench.acks() == [(22, DENIED)]
    assert "expected a number from 0.5 to 10000" in bench.texts()[0]
    await bench.ask(client, ARM)
    await bench.say(Word.COMPLETED)
    assert bench.drone.commands == [Arm()]


async def test_a_strangers_command_does_not_give_a_kept_takeoff_up(bench: Bench) -> None:
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


async def test_a_stream_gives_up_no_takeoff_that_waits_behind_an_arm(bench: Bench, client: Client) -> None:
    bench.clients.on_heartbeat(client, bench.now_ms)
    await ask(bench, client, ARM, TAKEOFF, STREAM)
    await bench.say(Word.ACCEPTED, 0)
    await bench.say(Word.COMPLETED, 0)
    assert [type(command) for command in bench.drone.commands if not isinstance(command, Stream)] == [Arm, Takeoff]
