"""No command is executed twice, behind a newer one, or after another station or client took the drone."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Airframe, Arm, Armed, Disarm, Goto, Hold, Land, Mavlink, Mission, StartMission, Word
from mqttxt.gateway.clients import Client
from mqttxt.gateway.modes import PX4
from mqttxt.gateway.translation import REQUEST_OPERATOR_CONTROL, Request
from tests.simulation.desk import Bench

ACCEPTED, NOT_NOW, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS, CANCELLED = range(7)
ARM = Request(400, (1.0, 0.0, None, None, None, None, None))
DISARM = Request(400, (0.0, 0.0, None, None, None, None, None))
LAND = Request(21, (None,) * 7)
HOLD = Request(176, (1.0, 4.0, 3.0, None, None, None, None))
RETURN = Request(20, (None,) * 7)
GOTO = Request(192, (-1.0, 1.0, 0.0, None, 47.001, 8.001, 510.0))
START = Request(300, (0.0,) * 7)
YAW = Request(115, (90.0, *[0.0] * 6))
TAKE = Request(REQUEST_OPERATOR_CONTROL, (1.0, 1.0, 10.0, 255.0, 0.0, 0.0, 0.0))


def beat(bench: Bench, *clients: Client) -> None:
    for client in clients:
        bench.clients.on_heartbeat(client, bench.now_ms)


async def uploaded(bench: Bench, client: Client) -> None:
    """Let a client upload a mission, which the drone does not have yet."""
    item = mavlink.MAVLink_mission_item_int_message(1, 1, 0, 6, 16, 0, 1, 0, 0, 0, 0, 473_977_420, 85_455_940, 20.0, 0)
    await bench.send(client, mavlink.MAVLink_mission_count_message(1, 1, 1, 0), item)


# Order


@pytest.mark.parametrize(
    ("older", "newer", "sent"), [(START, HOLD, Hold()), (ARM, DISARM, Disarm()), (START, LAND, Land())]
)
async def test_what_waited_for_a_plan_is_not_sent_behind_a_newer_command(
    bench: Bench, client: Client, older: Request, newer: Request, sent: Any
) -> None:
    """The client's last HEARTBEATs were lost when it sends the newer one; the plan is there before the next one."""
    await uploaded(bench, client)
    await bench.ask(client, older)
    bench.pass_time(3100)
    await bench.ask(client, newer)
    await bench.carry(Word.COMPLETED)
    assert bench.drone.commands == []
    beat(bench, client)
    await bench.settle()
    assert bench.drone.commands == [sent]
    assert "given up: another command came" in bench.texts()[-1]


@pytest.mark.parametrize("asked", [ARM, START])
async def test_what_waited_for_a_plan_is_not_sent_after_the_gateway_stood_still(
    bench: Bench, client: Client, asked: Request
) -> None:
    """The machine was suspended, for an hour maybe: client and drone go on as if nothing had been."""
    await uploaded(bench, client)
    await bench.ask(client, asked)
    bench.desk.on_stall()
    beat(bench, client)
    await bench.carry(Word.COMPLETED)
    assert bench.drone.commands == []
    assert bench.acks()[-1] == (asked.mav_cmd, NOT_NOW)
    assert "given up: the gateway stood still" in bench.texts()[-1]
    await bench.ask(client, asked)
    assert len(bench.drone.commands) == 1


async def test_what_waited_for_a_plan_is_not_sent_behind_a_newer_command_that_waited_for_control(
    bench: Bench, client: Client
) -> None:
    await uploaded(bench, client)
    await bench.ask(client, START)
    bench.drone.is_controlled = bench.drone.grants = False
    await bench.ask(client, HOLD)
    await bench.carry(Word.COMPLETED)
    bench.drone.is_controlled = True
    await asyncio.sleep(0.02)
    await bench.settle()
    assert bench.drone.commands == [Hold()]
    assert bench.acks()[-1] == (300, CANCELLED)


async def test_a_start_behind_a_hold_waits_for_the_plan_on(bench: Bench, client: Client) -> None:
    """It is newer than the hold, which is sent while it waits."""
    await uploaded(bench, client)
    bench.drone.is_controlled = bench.drone.grants = False
    await bench.ask(client, HOLD)
    await bench.ask(client, START)
    bench.drone.is_controlled = True
    await asyncio.sleep(0.02)
    await bench.settle()
    await bench.carry(Word.COMPLETED)
    assert [type(command) for command in bench.drone.commands] == [Hold, StartMission]


async def behind_a_waiting_goto(bench: Bench, newer: Request) -> tuple[Client, Client]:
    """A client's goto waits for its HEARTBEAT, and comes to its turn behind what a second client asks for."""
    first, second = bench.client(), bench.client("safety", 245)
    bench.pass_time(3100)
    beat(bench, second)
    await bench.ask(first, GOTO)
    await bench.ask(second, newer)
    beat(bench, first)
    await bench.settle()
    return first, second


async def test_an_older_goto_is_not_sent_behind_another_clients_hold(group: Any) -> None:
    bench = Bench(group, take_over=True)
    first, _ = await behind_a_waiting_goto(bench, HOLD)
    assert bench.drone.commands == [Hold()]
    assert bench.acks()[-1] == (192, CANCELLED)
    await bench.ask(first, LAND)
    assert bench.drone.commands == [Hold(), Land()], "what it commands from now on is newer"


@pytest.mark.parametrize("newer", [TAKE, YAW])
async def test_what_waits_does_not_take_the_drone_back_from_another_client(group: Any, newer: Request) -> None:
    bench = Bench(group, take_over=True)
    _, second = await behind_a_waiting_goto(bench, newer)
    assert not any(isinstance(command, Goto) for command in bench.drone.commands)
    assert bench.clients.controllers[1] == second


@pytest.mark.parametrize("waiting", [GOTO, TAKE])
async def test_what_waits_does_not_take_the_drone_back_from_another_station(group: Any, waiting: Request) -> None:
    bench = Bench(group, take_over=True)
    client = bench.client()
    await bench.ask(client, HOLD)
    await bench.say(Word.COMPLETED)
    bench.pass_time(3100)
    await bench.ask(client, waiting)
    await bench.taken()
    beat(bench, client)
    await asyncio.sleep(0.02)
    await bench.settle()
    assert (bench.drone.holder, bench.drone.commands) == ("gs-ops", [Hold()])
    assert bench.acks()[-1] == (waiting.mav_cmd, CANCELLED)


@pytest.mark.parametrize(
    "waiting",
    [
        mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", 5.0, 9),
        mavlink.MAVLink_mission_clear_all_message(1, 1, 0),
    ],
)
async def test_a_setting_or_a_plan_that_waits_does_not_take_the_drone_back(group: Any, waiting: Any) -> None:
    bench = Bench(group, take_over=True)
    client = bench.client()
    bench.pass_time(3100)
    await bench.send(client, waiting)
    await bench.taken()
    beat(bench, client)
    await asyncio.sleep(0.02)
    await bench.settle()
    assert (bench.drone.holder, bench.drone.sent, bench.drone.uploads) == ("gs-ops", [], [])
    assert bench.texts()[-1].endswith("given up: another station took the drone")


async def test_a_command_is_not_sent_if_a_station_takes_the_drone_while_control_is_awaited(
    bench: Bench, client: Client
) -> None:
    bench.drone.grants = False
    await bench.ask(client, GOTO)
    bench.desk.on_taken(1)
    bench.drone.is_controlled = True
    await asyncio.sleep(0.02)
    await bench.settle()
    assert (bench.drone.commands, bench.acks()) == ([], [(192, CANCELLED)])


async def test_a_command_is_not_sent_if_another_client_takes_the_drone_while_control_is_awaited(group: Any) -> None:
    bench = Bench(group, take_over=True)
    bench.drone.grants = False
    first, second = bench.client(), bench.client("safety", 245)
    await bench.ask(first, GOTO)
    await _granted_to_another(bench, second)
    assert (bench.drone.commands, bench.acks()) == ([], [(192, CANCELLED)])
    assert bench.texts()[-1] == "given up: its client has lost control"


async def test_nothing_is_set_if_another_client_takes_the_drone_while_control_is_awaited(group: Any) -> None:
    bench = Bench(group, take_over=True)
    bench.drone.grants = False
    first, second = bench.client(), bench.client("safety", 245)
    await bench.send(first, mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", 5.0, 9))
    await _granted_to_another(bench, second)
    assert bench.drone.sent == []
    assert bench.texts()[-1] == "MPC_XY_CRUISE not set: given up: its client has lost control"


async def _granted_to_another(bench: Bench, client: Any) -> None:
    """A client takes the drone while the gateway waits for control; then the gateway gets it."""
    await bench.send(client, mavlink.MAVLink_mission_count_message(1, 1, 1, 0))
    assert bench.clients.controllers[1] == client
    bench.drone.is_controlled = True
    await asyncio.sleep(0.02)
    await bench.settle()


# Repetitions


@pytest.mark.parametrize("is_others", [True, False])
async def test_a_repetition_is_not_executed_behind_a_newer_command(group: Any, is_others: bool) -> None:
    """The goto's ACCEPTED is lost, somebody holds, and the client repeats the goto."""
    bench = Bench(group, take_over=True)
    first, second = bench.client(), bench.client("safety", 245)
    await bench.ask(first, GOTO)
    await bench.say(Word.ACCEPTED)
    bench.pass_time(1500)
    beat(bench, first, second)
    await bench.ask(second if is_others else first, HOLD)
    await bench.say(Word.ACCEPTED)
    bench.pass_time(1000)
    beat(bench, first, second)
    await bench.ask(first, GOTO, confirmation=1)
    assert [type(command) for command in bench.drone.commands] == [Goto, Hold]
    assert bench.acks()[-1] == (192, ACCEPTED)
    await bench.ask(first, GOTO)
    assert isinstance(bench.drone.commands[-1], Goto), "unnumbered, it is meant anew"


async def test_a_repetition_without_a_number_is_not_executed_behind_another_clients_command(group: Any) -> None:
    """COMMAND_INT has no `confirmation`."""
    bench = Bench(group, take_over=True)
    first, second = bench.client(), bench.client("safety", 245)
    await bench.ask(first, GOTO)
    await bench.say(Word.ACCEPTED)
    await bench.ask(second, HOLD)
    bench.pass_time(500)
    await bench.ask(first, GOTO)
    assert [type(command) for command in bench.drone.commands] == [Goto, Hold]


async def test_a_denied_command_does_not_make_a_repetition_new(bench: Bench) -> None:
    client, stranger = bench.client(), bench.client("stranger", 200)
    await bench.ask(client, GOTO)
    await bench.say(Word.ACCEPTED)
    await bench.ask(stranger, Request(65_000, (0.0,) * 7))
    await bench.ask(stranger, LAND)
    await bench.ask(client, Request(65_000, (0.0,) * 7))
    for confirmation in (0, 1):
        await bench.ask(client, GOTO, confirmation)
    assert len(bench.drone.commands) == 1


async def test_a_command_that_is_meant_anew_can_be_repeated(bench: Bench, client: Client) -> None:
    for request in (HOLD, LAND, HOLD, HOLD):
        await bench.ask(client, request)
        await bench.say(Word.ACCEPTED)
    assert bench.drone.commands == [Hold(), Land(), Hold()]


@pytest.mark.parametrize(("stop", "other"), [(HOLD, GOTO), (HOLD, LAND), (LAND, GOTO), (RETURN, GOTO), (DISARM, GOTO)])
async def test_a_stop_behind_another_command_is_sent_though_an_equal_one_is_open(
    bench: Bench, client: Client, stop: Request, other: Request
) -> None:
    """The first words are slow; the pilot stops, goes on and stops again."""
    for request in (stop, other, stop):
        await bench.ask(client, request)
        bench.pass_time(400)
        beat(bench, client)
    first, between, last = bench.drone.commands
    assert first == last != between
    await bench.say(Word.SUPERSEDED, 0)
    assert ACCEPTED not in [result for _, result in bench.acks()]
    await bench.say(Word.ACCEPTED, 2)
    assert bench.acks()[-1] == (stop.mav_cmd, ACCEPTED)


async def test_an_open_stop_is_repeated_while_nothing_else_was_commanded(bench: Bench, client: Client) -> None:
    await bench.ask(client, HOLD)
    for confirmation in (0, 1, 2):
        await bench.ask(client, HOLD, confirmation)
    await bench.ask(client, GOTO)
    await bench.ask(client, HOLD, confirmation=3)
    assert [type(command) for command in bench.drone.commands] == [Hold, Goto]


@pytest.mark.parametrize("stop", [LAND, RETURN, DISARM])
async def test_an_open_stop_behind_a_hold_is_a_repetition(bench: Bench, client: Client, stop: Request) -> None:
    """A client that lost IN_PROGRESS repeats it without a number; the hold is the pilot's newest word."""
    for request in (stop, HOLD, stop):
        await bench.ask(client, request)
    assert len(bench.drone.commands) == 2
    assert isinstance(bench.drone.commands[-1], Hold)


async def test_an_open_goto_behind_another_command_is_a_repetition(bench: Bench, client: Client) -> None:
    """COMMAND_INT has no number: flying on behind a hold would be worse than a goto that is sent once more."""
    for request in (GOTO, HOLD, GOTO):
        await bench.ask(client, request)
    assert [type(command) for command in bench.drone.commands] == [Goto, Hold]


async def test_a_repetition_does_not_take_the_drone_back_from_another_station(group: Any) -> None:
    bench = Bench(group, take_over=True)
    client = bench.client()
    await bench.ask(client, GOTO)
    await bench.say(Word.ACCEPTED)
    await bench.taken()
    for confirmation in (0, 1):
        await bench.ask(client, GOTO, confirmation)
        await asyncio.sleep(0.02)
    assert (len(bench.drone.commands), bench.drone.holder) == (1, "gs-ops")


async def test_a_repetition_of_a_command_that_a_newer_one_of_its_number_replaced_is_not_executed(
    bench: Bench, client: Client
) -> None:
    await bench.ask(client, ARM)
    await bench.ask(client, DISARM)
    await bench.ask(client, ARM, confirmation=1)
    assert bench.drone.commands == [Arm(), Disarm()]


async def test_a_client_that_always_sends_one_confirmation_numbers_no_repetitions(bench: Bench, client: Client) -> None:
    for request in (HOLD, GOTO, HOLD):
        await bench.ask(client, request, confirmation=1)
        await bench.say(Word.ACCEPTED)
    assert [type(command) for command in bench.drone.commands] == [Hold, Goto, Hold]


async def test_a_command_that_was_declined_here_can_be_tried_again_at_once(bench: Bench) -> None:
    client, other = bench.client(), bench.client("script", 245)
    await bench.ask(other, LAND)
    await bench.ask(client, HOLD)
    assert bench.acks() == [(176, DENIED)]
    await bench.ask(client, HOLD, confirmation=1)
    assert bench.acks() == [(176, DENIED)] * 2
    bench.clients.on_gone(other.peer)
    await bench.ask(client, HOLD)
    assert bench.drone.commands == [Land(), Hold()]


async def test_a_late_command_is_declined_and_a_late_repetition_is_answered(bench: Bench, client: Client) -> None:
    await bench.ask(client, LAND)
    await bench.ask(client, LAND, confirmation=1, is_late=True)
    await bench.ask(client, YAW, is_late=True)
    assert bench.acks() == [(21, IN_PROGRESS), (115, NOT_NOW)]
    assert "stood still" in bench.texts()[-1]
    await bench.ask(client, YAW, confirmation=1)
    assert (bench.acks()[-1], bench.drone.commands) == ((115, NOT_NOW), [Land()])
    await bench.ask(client, YAW)
    assert bench.drone.commands == [Land(), Mavlink(115, YAW.params)]


async def test_of_a_client_that_is_gone_nothing_is_sent_when_another_one_beats(bench: Bench) -> None:
    client, other = bench.client(), bench.client("script", 245)
    bench.pass_time(3100)
    await bench.ask(client, LAND)
    bench.clients.on_gone(client.peer)
    beat(bench, other)
    await bench.settle()
    assert bench.drone.commands == []


async def test_a_client_that_numbers_its_repetitions_and_goes_on_is_not_obeyed_twice(
    bench: Bench, client: Client
) -> None:
    """The drone may have armed, and nothing was acknowledged: the client has no reason to stop."""
    await bench.ask(client, ARM)
    await bench.say(Word.UNCONFIRMED)
    for confirmation in range(1, 30):
        bench.pass_time(3000)
        beat(bench, client)
        await bench.ask(client, ARM, confirmation)
    assert bench.drone.commands == [Arm()]
    bench.pass_time(10_050)
    beat(bench, client)
    await bench.ask(client, ARM, 30)
    assert bench.drone.commands == [Arm(), Arm()]


async def test_a_client_that_connects_anew_and_repeats_is_not_obeyed_twice(bench: Bench, client: Client) -> None:
    """A mission that is flown would begin anew."""
    bench.states = (*bench.states, Mission(1, 0, 3, b"m" * 16))
    await bench.ask(client, START)
    bench.clients.on_gone(client.peer)
    again = bench.client("again")
    await bench.ask(again, START, confirmation=1)
    await bench.say(Word.ACCEPTED)
    assert [(ack.command, ack.result) for ack in bench.of("COMMAND_ACK", "again")] == [
        (300, IN_PROGRESS),
        (300, ACCEPTED),
    ]
    assert (len(bench.drone.commands), bench.of("COMMAND_ACK")) == (1, [])


async def test_clients_that_share_an_id_do_not_repeat_each_others_commands(bench: Bench, client: Client) -> None:
    await bench.ask(client, LAND)
    await bench.ask(bench.client("other"), LAND, confirmation=1)
    await bench.say(Word.ACCEPTED)
    assert bench.acks() == [(21, ACCEPTED)]
    assert [ack.result for ack in bench.of("COMMAND_ACK", "other")] == [DENIED]


async def test_ten_seconds_after_its_end_or_repetition_a_command_is_forgotten(bench: Bench, client: Client) -> None:
    """The same one is new then, however it is numbered."""
    bench.states = (Airframe(PX4, 2), Armed(False))
    await bench.ask(client, ARM)
    await bench.say(Word.COMPLETED)
    bench.pass_time(10_000)
    beat(bench, client)
    await bench.ask(client, ARM, confirmation=2)
    assert bench.drone.commands == [Arm()]
    bench.pass_time(10_050)
    beat(bench, client)
    await bench.ask(client, ARM, confirmation=3)
    assert bench.drone.commands == [Arm(), Arm()]
