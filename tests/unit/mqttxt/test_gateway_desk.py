"""A client's command from its first COMMAND_ACK to its last word; who may command (docs/gateway.md)."""

from __future__ import annotations

import asyncio
import math
from typing import Any, cast

import pytest

from mqttxt import Arm, Armed, Drone, FogUnreachable, Hold, Land, Mavlink, PayloadError, Word
from mqttxt.gateway import control
from mqttxt.gateway.clients import Client
from mqttxt.gateway.desk import MOST_UNDER_WAY
from mqttxt.gateway.translation import REQUEST_OPERATOR_CONTROL, Request
from tests.simulation.desk import Bench

ACCEPTED, NOT_NOW, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS, CANCELLED = range(7)
ARM = Request(400, (1.0, 0.0, None, None, None, None, None))
LAND = Request(21, (None,) * 7)
HOLD = Request(176, (1.0, 4.0, 3.0, None, None, None, None))
RETURN = Request(176, (1.0, 4.0, 5.0, None, None, None, None))
TAKE = Request(REQUEST_OPERATOR_CONTROL, (1.0, 1.0, 10.0, 255.0, 0.0, 0.0, 0.0))
GIVE = Request(REQUEST_OPERATOR_CONTROL, (0.0, 0.0, 0.0, 255.0, 0.0, 0.0, 0.0))


async def test_a_command_is_in_progress_until_it_is_accepted_and_its_last_word_is_a_text(
    bench: Bench, client: Client
) -> None:
    await bench.ask(client, LAND)
    assert bench.acks() == []
    bench.pass_time(3000)
    assert bench.acks() == [(21, IN_PROGRESS)] * 3
    await bench.say(Word.ACCEPTED)
    assert bench.acks()[3:] == [(21, ACCEPTED)]
    bench.pass_time(5000)
    await bench.say(Word.COMPLETED)
    assert (bench.acks()[4:], bench.texts()) == ([], ["land completed"])
    assert bench.drone.commands == [Land()]


@pytest.mark.parametrize(
    ("word", "result"),
    [
        (Word.COMPLETED, ACCEPTED),
        (Word.DENIED, DENIED),
        (Word.UNSUPPORTED, UNSUPPORTED),
        (Word.FAILED, FAILED),
        (Word.EXPIRED, NOT_NOW),
        (Word.UNREACHABLE, NOT_NOW),
        (Word.SUPERSEDED, CANCELLED),
        (Word.OVERTAKEN, CANCELLED),
    ],
)
async def test_a_last_word_without_a_first_is_the_acknowledgement(bench: Bench, word: Word, result: int) -> None:
    await bench.ask(bench.client(), LAND)
    await bench.say(word, reason="why")
    assert bench.acks() == [(21, result)]
    assert word.label in bench.texts()[0]


@pytest.mark.parametrize("word", [Word.DENIED, Word.EXPIRED, Word.UNREACHABLE])
async def test_the_word_of_an_activator_alone_is_no_definite_no(group: Any, word: Word) -> None:
    """In a fleet that signs, the drone may have got the command, and has said nothing."""
    for signer, acks in (("fog1", []), ("drone1", [(21, NOT_NOW if word is not Word.DENIED else DENIED)])):
        bench = Bench(group)
        await bench.ask(bench.client(), LAND)
        await bench.say(word, signer=signer)
        assert bench.acks() == acks
        assert ("by the word of fog1 alone" in bench.texts()[0]) == (signer == "fog1")


async def test_one_drones_commands_without_a_last_word_are_bounded_and_it_can_still_be_halted(
    bench: Bench, client: Client
) -> None:
    for number in range(MOST_UNDER_WAY):
        await bench.ask(client, Request(115, (float(number), *[0.0] * 6)))
    await bench.ask(client, Request(115, (90.5, *[0.0] * 6)))
    assert bench.acks() == [(115, NOT_NOW)]
    assert bench.texts() == [f"CONDITION_YAW: {MOST_UNDER_WAY} commands for this drone have no last word yet"]
    await bench.ask(client, LAND)
    assert bench.drone.commands[-1] == Land()
    for number in range(MOST_UNDER_WAY + 1):
        await bench.say(Word.COMPLETED, number)
    await bench.ask(client, Request(115, (91.0, *[0.0] * 6)))
    assert bench.drone.commands[-1] == Mavlink(115, (91.0, *[0.0] * 6))


async def test_a_hold_by_mode_is_acknowledged_once_and_never_in_progress(bench: Bench, client: Client) -> None:
    """MAVSDK's pause_mission() returns with the first word, IN_PROGRESS too, and the second one ends its process."""
    await bench.ask(client, HOLD)
    for repetition in range(1, 8):
        bench.pass_time(500)
        await bench.ask(client, HOLD, repetition)
    assert bench.acks() == []
    await bench.say(Word.ACCEPTED)
    assert bench.acks() == [(176, ACCEPTED)]
    assert bench.drone.commands == [Hold()]


async def test_a_return_by_mode_is_in_progress_as_other_commands_are(bench: Bench, client: Client) -> None:
    await bench.ask(client, RETURN)
    bench.pass_time(500)
    assert bench.acks() == [(176, IN_PROGRESS)]
    await bench.ask(client, RETURN, 1)
    await bench.say(Word.ACCEPTED)
    assert bench.acks() == [(176, IN_PROGRESS), (176, IN_PROGRESS), (176, ACCEPTED)]


async def test_of_what_nobody_knows_nothing_is_acknowledged(bench: Bench) -> None:
    await bench.ask(bench.client(), LAND)
    bench.pass_time(500)
    await bench.say(Word.UNCONFIRMED, reason="no_ack")
    bench.pass_time(5000)
    assert bench.acks() == [(21, IN_PROGRESS)]
    assert bench.texts() == ["land unconfirmed(no_ack)"]


async def test_a_command_without_any_word_is_not_in_progress_for_ever(bench: Bench) -> None:
    await bench.ask(bench.client(), LAND)
    bench.pass_time(15_000)
    assert len(bench.acks()) == 15
    bench.pass_time(5000)
    assert bench.acks() == [(21, IN_PROGRESS)] * 15
    assert "may have been done" in bench.texts()[-1]
    await bench.say(Word.EXPIRED)
    assert (bench.acks()[15:], bench.texts()[-1]) == ([], "land expired")


async def test_a_command_that_is_under_way_stays_in_progress_with_its_percentage(bench: Bench) -> None:
    await bench.ask(bench.client(), LAND)
    await bench.say(Word.IN_PROGRESS, percent=40)
    bench.pass_time(30_000)
    assert bench.acks() == [(21, IN_PROGRESS)] * 30
    assert {message.progress for message in bench.of("COMMAND_ACK")} == {40}


async def test_a_repeated_command_is_the_same_command(bench: Bench, client: Client) -> None:
    await bench.ask(client, LAND)
    await bench.ask(client, LAND, confirmation=1)
    assert bench.acks() == [(21, IN_PROGRESS)]
    await bench.say(Word.ACCEPTED)
    bench.pass_time(900)
    await bench.ask(client, LAND)
    bench.pass_time(2000)
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.ask(client, LAND, confirmation=2)
    assert bench.acks()[1:] == [(21, ACCEPTED)] * 3
    assert len(bench.drone.sent) == 1
    await bench.ask(client, LAND)
    assert len(bench.drone.sent) == 2, "seconds later it is meant anew"


async def test_of_two_of_one_number_the_newer_is_acknowledged(bench: Bench, client: Client) -> None:
    await bench.ask(client, HOLD)
    await bench.ask(client, RETURN)
    await bench.say(Word.SUPERSEDED, 0)
    assert bench.acks() == []
    await bench.say(Word.ACCEPTED, 1)
    assert bench.acks() == [(176, ACCEPTED)]


async def test_what_the_station_does_not_send_is_a_no(bench: Bench, client: Client) -> None:
    for error, result in (
        (FogUnreachable("fog 1: no live activator"), NOT_NOW),
        (PayloadError("takeoff: high"), DENIED),
    ):
        bench.drone.error = error
        await bench.ask(client, Request(22, (*[None] * 6, 500.0 + result)))
        assert bench.acks()[-1] == (22, result)
        assert str(error) in bench.texts()[-1]


# Control


async def test_only_who_sends_heartbeats_commands(
    bench: Bench, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "HEARTBEAT_S", 0.02)
    bench.pass_time(3100)
    await bench.ask(client, LAND)
    await asyncio.sleep(0.1)
    await bench.settle()
    assert (bench.acks(), bench.drone.sent) == ([(21, DENIED)], [])
    assert "HEARTBEAT" in bench.texts()[0]


async def test_a_command_waits_for_its_clients_first_heartbeat(bench: Bench, client: Client) -> None:
    """MAVSDK sends it up to a second after its first command."""
    bench.pass_time(3100)
    for request in (ARM, LAND):
        await bench.ask(client, request)
    assert bench.drone.sent == []
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.settle()
    assert bench.drone.commands == [Arm(), Land()]


async def test_control_is_wanted_while_the_controlling_client_is_alive(bench: Bench, client: Client) -> None:
    bench.control.review(cast(Drone, bench.drone), Armed(True))
    assert not bench.drone.wanted, "who only watches controls nothing"
    await bench.ask(client, LAND)
    assert bench.drone.wanted
    bench.pass_time(3100)
    bench.control.review(cast(Drone, bench.drone), Armed(True))
    assert not bench.drone.wanted
    bench.clients.on_heartbeat(client, bench.now_ms)
    bench.control.review(cast(Drone, bench.drone), Armed(True))
    assert bench.drone.wanted
    bench.clients.on_gone(client.peer)
    bench.control.review(cast(Drone, bench.drone), Armed(True))
    assert not bench.drone.wanted


async def test_a_client_that_comes_back_after_long_controls_nothing(bench: Bench, client: Client) -> None:
    await bench.ask(client, LAND)
    bench.pass_time(31_000)
    bench.clients.forget(bench.now_ms)
    bench.clients.on_heartbeat(client, bench.now_ms)
    bench.control.review(cast(Drone, bench.drone), Armed(True))
    assert not bench.drone.wanted


async def test_a_second_client_is_refused_until_the_first_is_gone(bench: Bench) -> None:
    first, second = bench.client(), bench.client("script", 255)
    await bench.ask(first, LAND)
    await bench.ask(second, HOLD)
    assert bench.acks("script") == [(176, DENIED)]
    assert "controlled by system 255 at qgc" in bench.texts("script")[0]
    bench.pass_time(3100)
    bench.clients.on_heartbeat(second, bench.now_ms)
    await bench.ask(second, HOLD)
    assert bench.drone.commands == [Land(), Hold()]
    assert (21, IN_PROGRESS) not in bench.acks("script"), "answers go to who asked"


async def test_control_can_be_taken_and_given_up(bench: Bench) -> None:
    first, second = bench.client(), bench.client("script", 245)
    await bench.ask(first, LAND)
    await bench.ask(second, TAKE)
    assert bench.acks("script") == [(REQUEST_OPERATOR_CONTROL, ACCEPTED)]
    assert "control was taken by system 245" in bench.texts()[-1]
    await bench.ask(first, HOLD)
    assert bench.acks()[-1] == (176, DENIED)
    await bench.ask(second, GIVE)
    assert not bench.drone.wanted
    await bench.ask(first, HOLD)
    assert bench.drone.commands == [Land(), Hold()]


@pytest.mark.parametrize("params", [(None, 1.0), (255.0, 1.0), (0.5, 1.0), (-1.0, 1.0), (0.0, 1.0), (math.inf, 0.0)])
async def test_control_is_taken_and_given_up_by_whole_words_only(
    bench: Bench, params: tuple[float | None, float]
) -> None:
    first, second = bench.client(), bench.client("script", 245)
    await bench.ask(first, LAND)
    for client, name in ((second, "script"), (first, "qgc")):
        await bench.ask(client, Request(REQUEST_OPERATOR_CONTROL, (*params, *[0.0] * 5)))
        assert bench.acks(name)[-1] == (REQUEST_OPERATOR_CONTROL, DENIED)
    assert (bench.clients.controllers[1], bench.drone.wanted) == (first, True)


async def test_a_drone_of_another_station_is_not_commanded_unless_taken_over(group: Any) -> None:
    for take_over in (False, True):
        bench = Bench(group, take_over)
        bench.drone.holder = "gs-ops"
        await bench.ask(bench.client(), LAND)
        await asyncio.sleep(0.01)
        await bench.settle()
        assert bench.drone.commands == ([Land()] if take_over else [])
        assert bench.drone.wanted == take_over
        if not take_over:
            assert bench.acks() == [(21, DENIED)]
            assert "gs-ops" in bench.texts()[0]


async def test_control_that_does_not_come_is_a_no(bench: Bench) -> None:
    bench.drone.grants = False
    await bench.ask(bench.client(), LAND)
    await asyncio.sleep(0.1)
    await bench.settle()
    assert bench.acks() == [(21, NOT_NOW)]
    assert bench.drone.sent == []


async def test_a_command_that_waited_for_control_is_not_sent_after_its_time(bench: Bench, client: Client) -> None:
    bench.drone.grants = False
    for request in (LAND, HOLD, ARM):
        await bench.ask(client, request)
    bench.pass_time(3000)
    bench.clients.on_heartbeat(client, bench.now_ms)
    bench.pass_time(2100)
    bench.drone.is_controlled = True
    for _ in range(5):
        await asyncio.sleep(0.02)
    assert bench.drone.sent == []
    assert sorted(ack for ack in bench.acks() if ack[1] != IN_PROGRESS) == [
        (21, NOT_NOW),
        (176, NOT_NOW),
        (400, NOT_NOW),
    ]


async def test_a_client_is_told_that_another_station_has_taken_its_drone(bench: Bench) -> None:
    await bench.ask(bench.client(), LAND)
    bench.control.on_taken(cast(Drone, bench.drone), "gs-ops")
    assert not bench.drone.wanted
    assert "gs-ops" in bench.texts()[-1]


async def test_with_take_over_a_repetition_takes_nothing_back(group: Any) -> None:
    bench = Bench(group, take_over=True)
    first, second = bench.client(), bench.client("script", 245)
    await bench.ask(first, LAND)
    await bench.ask(second, HOLD)
    await bench.ask(first, LAND, confirmation=1)
    assert bench.drone.commands == [Land(), Hold()]
    assert bench.texts() == ["control was taken by system 245 at script"]
    assert bench.texts("script") == []
