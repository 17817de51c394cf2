"""Plans from clients to a drone and back: in time, whole, and by who controls it alone (docs/gateway.md)."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Airframe, Arm, Armed, Hold, Home, Mission, Plan, StartMission, Word
from mqttxt.errors import ConfigurationError, PayloadError, TransferFailed
from mqttxt.gateway.clients import Client
from mqttxt.gateway.modes import ARDUPILOT, PX4
from mqttxt.gateway.translation import Request
from mqttxt.protocol.plans import PlanItem, PlanList, PlanObject, list_hash
from tests.simulation.desk import Bench

ACCEPTED, ERROR, NO_SPACE, INVALID_PARAM5, DENIED, CANCELLED = 0, 1, 4, 10, 14, 15
ARM = Request(400, (1.0, 0.0, None, None, None, None, None))
START = Request(300, (0.0,) * 7)
HOLD = Request(176, (1.0, 4.0, 3.0, None, None, None, None))
ENTER = Request(176, (1.0, 4.0, 4.0, None, None, None, None))
OLD = (PlanItem(3, 16, (0.0, 0.0, 0.0, 0.0), 1, 2, 3.0, True),)


def item(seq: int, kind: int = 0, command: int = 16, x: int = 473_977_420) -> Any:
    place = (x, 85_455_940 + seq, 20.0)
    return mavlink.MAVLink_mission_item_int_message(1, 1, seq, 6, command, 0, 1, 0, 0, 0, 0, *place, kind)


def of_plan(seq: int, command: int = 16) -> PlanItem:
    return PlanItem(3, command, (0.0, 0.0, 0.0, 0.0), 473_977_420, 85_455_940 + seq, 20.0, True)


def count(number: int, kind: int = 0) -> Any:
    return mavlink.MAVLink_mission_count_message(1, 1, number, kind)


def clear(kind: int = 0) -> Any:
    return mavlink.MAVLink_mission_clear_all_message(1, 1, kind)


def wanted(kind: int = 0) -> Any:
    return mavlink.MAVLink_mission_request_list_message(1, 1, kind)


def acks(bench: Bench, name: str = "qgc") -> list[tuple[int, int]]:
    return [(ack.type, ack.mission_type) for ack in bench.of("MISSION_ACK", name)]


def asked(bench: Bench, name: str = "qgc") -> list[int]:
    return [request.seq for request in bench.of("MISSION_REQUEST_INT", name)]


async def upload(bench: Bench, client: Client, items: int = 3, kind: int = 0, command: int = 16) -> None:
    await bench.send(client, count(items, kind), *(item(seq, kind, command) for seq in range(items)))


async def test_a_plan_is_asked_for_item_by_item_and_accepted_when_the_drone_has_verified_it(bench: Bench) -> None:
    await upload(bench, bench.client())
    assert (asked(bench), acks(bench)) == ([0, 1, 2], [])
    (plan, _), mission = bench.drone.uploads[0], tuple(map(of_plan, range(3)))
    assert plan == Plan(PlanObject(mission=mission))
    await bench.carry(Word.COMPLETED)
    assert (acks(bench), bench.texts()) == ([(ACCEPTED, 0)], [])
    assert bench.copies.get(1, PlanList.MISSION) == mission


async def test_a_plan_that_takes_long_is_accepted_after_a_second_and_a_text_says_when_the_drone_has_it(
    bench: Bench,
) -> None:
    await upload(bench, bench.client())
    bench.pass_time(950)
    assert acks(bench) == []
    bench.pass_time(100)
    assert acks(bench) == [(ACCEPTED, 0)]
    await bench.carry(Word.COMPLETED)
    assert (acks(bench), bench.texts()) == ([(ACCEPTED, 0)], ["mission upload completed: 3 items"])


@pytest.mark.parametrize(
    ("word", "reason", "result"),
    [
        (Word.FAILED, "mission item 2: unsupported", 3),
        (Word.FAILED, "partial, mission item 2: invalid_param5_x", INVALID_PARAM5),
        (Word.FAILED, "timeout", ERROR),
        (Word.DENIED, "mission_running", DENIED),
        (Word.EXPIRED, None, ERROR),
        (Word.UNCONFIRMED, "autopilot_lost", ERROR),
    ],
)
async def test_the_drones_no_is_the_result_where_it_comes_in_time(
    bench: Bench, client: Client, word: Word, reason: str | None, result: int
) -> None:
    bench.copies.put(1, {PlanList.MISSION: OLD})
    await upload(bench, client)
    await bench.carry(word, reason=reason)
    assert acks(bench) == [(result, 0)]
    assert bench.texts() == [f"mission upload {word.label}{f'({reason})' if reason else ''}"]
    assert bench.copies.get(1, PlanList.MISSION) is None, "what the drone has now is read from it"
    await bench.ask(client, ARM)
    assert bench.drone.commands == [Arm()], "its client knows"


@pytest.mark.parametrize("request_", [ARM, START])
async def test_arm_and_start_wait_for_the_drone_to_verify_the_plan(
    bench: Bench, client: Client, request_: Request
) -> None:
    await upload(bench, client)
    bench.pass_time(1100)
    await bench.ask(client, request_)
    for _ in range(20):
        bench.pass_time(1000)
        bench.clients.on_heartbeat(client, bench.now_ms)
    assert (bench.acks(), bench.drone.commands) == ([(request_.mav_cmd, 5)] * 20, [])
    assert bench.texts()[0].endswith("waits until the drone has the plan")
    await bench.carry(Word.COMPLETED)
    mission = list_hash(map(of_plan, range(3)))
    assert bench.drone.commands == [Arm() if request_ is ARM else StartMission(mission, 1)]
    await bench.say(Word.ACCEPTED)
    assert bench.acks()[20:] == [(request_.mav_cmd, 0)]


async def test_a_missions_mode_that_waits_for_the_plan_is_declined_before_its_client_gives_up(
    bench: Bench, client: Client
) -> None:
    await upload(bench, client)
    bench.pass_time(1100)
    await bench.ask(client, ENTER)
    bench.pass_time(1600)
    assert bench.acks() == []
    bench.pass_time(200)
    assert bench.acks() == [(176, 1)]
    assert bench.texts()[-1].endswith("the drone does not have the plan yet, not sent: send it again")
    said = bench.texts()
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.carry(Word.COMPLETED)
    assert (bench.drone.commands, bench.acks()) == ([], [(176, 1)])
    assert [text for text in bench.texts() if text not in said] == ["mission upload completed: 3 items"]
    bench.pass_time(1100)
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.ask(client, ENTER)
    assert bench.drone.commands == [StartMission(list_hash(map(of_plan, range(3))), 1)]


@pytest.mark.parametrize("request_", [ARM, START])
async def test_a_failed_upload_that_was_accepted_denies_arm_and_start_with_a_text(
    bench: Bench, client: Client, request_: Request
) -> None:
    await upload(bench, client)
    bench.pass_time(1100)
    await bench.ask(client, request_)
    await bench.carry(Word.FAILED, reason="mission item 2: unsupported")
    assert (bench.acks()[-1], bench.drone.commands) == ((request_.mav_cmd, 2), [])
    why = "mission upload failed(mission item 2: unsupported)"
    assert bench.texts()[-2:] == [why, f"{why}: upload it again, clear it, or read what the drone has"]
    bench.pass_time(2000)
    bench.clients.on_heartbeat(client, bench.now_ms)
    bench.states = (*bench.states, Mission(1, 0, 6, b"of another place"))
    await bench.ask(client, request_)
    assert (bench.acks()[-1], bench.drone.commands) == ((request_.mav_cmd, 2), [])
    bench.drone.plan = Plan(PlanObject(mission=OLD, fence=(), rally=()))
    await bench.send(client, wanted())
    bench.pass_time(2000)
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.ask(client, request_)
    assert bench.drone.commands == [Arm() if request_ is ARM else StartMission(list_hash(OLD), 1)]


async def test_another_list_that_arrives_makes_up_for_no_failed_one(bench: Bench, client: Client) -> None:
    await upload(bench, client)
    bench.pass_time(1100)
    await bench.carry(Word.FAILED, reason="mission item 2: unsupported")
    bench.clients.on_heartbeat(client, bench.now_ms)
    await upload(bench, client, 1, 2, 5100)
    await bench.carry(Word.COMPLETED)
    await bench.send(client, wanted(2))
    await bench.ask(client, ARM)
    assert (bench.acks(), bench.drone.commands) == ([(400, 2)], [])
    await upload(bench, client)
    await bench.carry(Word.COMPLETED)
    await bench.ask(client, HOLD)
    await bench.ask(client, ARM)
    assert bench.drone.commands == [Hold(), Arm()]


async def test_what_waits_for_a_plan_is_given_up_for_a_hold_and_for_a_client_that_has_gone(
    bench: Bench, client: Client
) -> None:
    await upload(bench, client)
    await bench.ask(client, ARM)
    await bench.ask(client, HOLD)
    await bench.carry(Word.COMPLETED)
    assert bench.drone.commands == [Hold()]
    assert bench.acks() == [(400, 6)]
    await upload(bench, client)
    await bench.ask(client, ARM)
    bench.pass_time(4000)
    await bench.carry(Word.COMPLETED)
    assert bench.drone.commands == [Hold()]


async def test_three_lists_that_come_one_behind_the_other_are_carried_as_few(bench: Bench, client: Client) -> None:
    await upload(bench, client)
    await upload(bench, client, 1, 2, 5100)
    await bench.send(client, clear(1))
    assert [plan.content.lists.keys() for plan, _ in bench.drone.uploads] == [{PlanList.MISSION}]
    await bench.carry(Word.COMPLETED)
    assert [plan.content.lists.keys() for plan, _ in bench.drone.uploads[1:]] == [{PlanList.RALLY, PlanList.FENCE}]
    await bench.carry(Word.COMPLETED)
    assert acks(bench) == [(ACCEPTED, 0), (ACCEPTED, 2), (ACCEPTED, 1)]
    assert bench.copies.get(1, PlanList.FENCE) == ()


async def test_all_lists_are_cleared_at_once_and_a_repetition_is_the_same(bench: Bench, client: Client) -> None:
    await bench.send(client, clear(255), clear(0))
    lists = [plan.content.lists for plan, _ in bench.drone.uploads]
    await bench.carry(Word.COMPLETED)
    lists += [plan.content.lists for plan, _ in bench.drone.uploads[1:]]
    await bench.carry(Word.COMPLETED)
    assert lists == [{PlanList.MISSION: ()}, {PlanList.FENCE: (), PlanList.RALLY: ()}]
    assert acks(bench) == [(ACCEPTED, 0), (ACCEPTED, 1), (ACCEPTED, 2)]


MEANT = list_hash(map(of_plan, range(2)))


async def upload_two(bench: Bench, client: Client) -> None:
    """A client's second mission, of two items, comes whole while its first, of three, is carried."""
    await upload(bench, client, 3)
    bench.pass_time(1100)
    await upload(bench, client, 2)
    bench.clients.on_heartbeat(client, bench.now_ms)


@pytest.mark.parametrize("first", [Word.COMPLETED, Word.FAILED])
async def test_a_start_means_the_mission_that_was_sent_last_whatever_becomes_of_the_one_before(
    bench: Bench, client: Client, first: Word
) -> None:
    await upload_two(bench, client)
    await bench.carry(first, 0)
    await bench.ask(client, START)
    await bench.carry(Word.COMPLETED, 1)
    assert bench.drone.commands == [StartMission(MEANT, 1)]


async def test_a_start_behind_a_mission_that_the_drone_does_not_take_flies_no_older_one(
    bench: Bench, client: Client
) -> None:
    await upload_two(bench, client)
    await bench.carry(Word.COMPLETED, 0)
    await bench.ask(client, START)
    await bench.carry(Word.FAILED, 1, reason="mission item 2: unsupported")
    assert bench.drone.commands == [StartMission(MEANT, 1)], "which the drone denies: it has another one"


@pytest.mark.parametrize("broken_at", range(3))
async def test_an_upload_that_breaks_off_leaves_the_old_plan(bench: Bench, client: Client, broken_at: int) -> None:
    bench.copies.put(1, {PlanList.MISSION: OLD})
    await bench.send(client, count(3), *(item(seq) for seq in range(broken_at)))
    for _ in range(6):
        bench.pass_time(1000)
        bench.clients.on_heartbeat(client, bench.now_ms)
    assert asked(bench).count(broken_at) > 5
    assert acks(bench) == [(CANCELLED, 0)]
    assert bench.texts() == [f"mission upload broke off at item {broken_at + 1} of 3: the old one stays"]
    assert bench.copies.get(1, PlanList.MISSION) == OLD
    await bench.send(client, *(item(seq) for seq in range(broken_at, 3)))
    assert bench.drone.uploads == []


async def test_a_client_that_cancels_leaves_the_old_plan_until_all_is_sent(bench: Bench, client: Client) -> None:
    cancel = mavlink.MAVLink_mission_ack_message(1, 1, CANCELLED, 0)
    await bench.send(client, count(3), item(0), cancel, item(1), item(2))
    assert (bench.drone.uploads, acks(bench)) == ([], [(CANCELLED, 0)])
    await upload(bench, client)
    await bench.send(client, cancel)
    await bench.carry(Word.COMPLETED)
    assert acks(bench)[1:] == [(ACCEPTED, 0)]


@pytest.mark.parametrize(
    ("messages", "result", "text"),
    [
        ([count(3), item(0), item(1, x=2**31 - 1)], INVALID_PARAM5, "mission item 2: latitude: expected"),
        ([count(3), item(0), item(1), item(2, command=31_999)], 3, "mission item 3: command: expected"),
        ([count(2001)], NO_SPACE, "mission: expected at most 2000 items, got 2001"),
        ([count(1, 1), item(0, 1)], 3, "fence item 1: command"),
        ([count(2, 7)], 3, "mission type 7: expected 0, 1 or 2"),
        ([wanted(255)], 3, "mission type 255: expected 0, 1 or 2"),
        ([mavlink.MAVLink_mission_write_partial_list_message(1, 1, 1, 2, 0)], 3, "upload the whole list"),
    ],
)
async def test_a_plan_with_a_mistake_is_refused_whole(
    bench: Bench, client: Client, messages: list[Any], result: int, text: str
) -> None:
    bench.copies.put(1, {PlanList.MISSION: OLD})
    await bench.send(client, *messages, item(2))
    assert [found for found, _ in acks(bench)] == [result]
    assert text in bench.texts()[0]
    assert (bench.drone.uploads, bench.copies.get(1, PlanList.MISSION)) == ([], OLD)


async def test_items_that_were_not_asked_for_change_nothing(bench: Bench, client: Client) -> None:
    await bench.send(client, item(0), count(3), count(3), item(1), item(0), item(0), item(2), item(1), item(2))
    assert asked(bench) == [0, 0, 1, 2]
    (plan, _) = bench.drone.uploads[0]
    assert plan.content.mission == tuple(map(of_plan, range(3)))


async def test_a_client_that_begins_anew_uploads_what_it_sends_last(bench: Bench, client: Client) -> None:
    await bench.send(client, count(3), item(0), count(2), item(0), item(1))
    assert [plan.content.mission for plan, _ in bench.drone.uploads] == [tuple(map(of_plan, range(2)))]


async def test_of_two_clients_only_the_one_in_control_uploads(bench: Bench) -> None:
    first, second = bench.client(), bench.client("script", 245)
    await bench.send(first, count(2), item(0))
    await bench.send(second, count(1), item(0), item(1))
    assert (acks(bench, "script"), asked(bench, "script")) == ([(DENIED, 0)], [])
    assert bench.texts("script") == ["controlled by system 255 at qgc"]
    await bench.send(first, item(1))
    assert [plan.content.mission for plan, _ in bench.drone.uploads] == [tuple(map(of_plan, range(2)))]
    assert acks(bench) == []


async def test_with_take_over_the_second_upload_ends_the_first(group: Any) -> None:
    bench = Bench(group, take_over=True)
    first, second = bench.client(), bench.client("script", 245)
    await bench.send(first, count(2), item(0))
    await upload(bench, second, 1)
    await bench.send(first, item(1))
    assert acks(bench) == [(CANCELLED, 0)]
    assert [plan.content.mission for plan, _ in bench.drone.uploads] == [(of_plan(0),)]
    bench.pass_time(50)
    await upload(bench, first, 3)
    bench.pass_time(50)
    await bench.settle()
    assert [len(plan.content.mission or ()) for plan, _ in bench.drone.uploads] == [1, 3]
    assert bench.texts("script") == [
        "control was taken by system 255 at qgc",
        "mission upload: control is lost; the drone may have the new list",
    ]


async def test_a_list_that_waited_for_another_one_is_not_carried_once_its_client_has_lost_control(group: Any) -> None:
    bench = Bench(group, take_over=True)
    first, second = bench.client(), bench.client("script", 245)
    await upload(bench, first, 1)
    await upload(bench, first, 1, kind=2, command=5100)
    await bench.ask(second, HOLD)
    await bench.carry(Word.COMPLETED)
    assert [plan.content.mission for plan, _ in bench.drone.uploads] == [(of_plan(0),)]
    assert acks(bench) == [(ACCEPTED, 0), (DENIED, 2)]


@pytest.mark.parametrize("by", ["command", "control", "station"])
async def test_a_list_whose_client_lost_control_before_its_last_item_is_not_carried(group: Any, by: str) -> None:
    bench = Bench(group, take_over=by == "command")
    first, second = bench.client(), bench.client("script", 245)
    await bench.send(first, count(2), item(0))
    if by == "station":
        await bench.taken()
    else:
        take = Request(32100, (1.0, 1.0, 1.0, None, None, None, None))
        await bench.ask(second, HOLD if by == "command" else take)
    await bench.send(first, item(1))
    assert (bench.drone.uploads, acks(bench)) == ([], [(DENIED, 0)])
    assert bench.texts()[-1] == "mission upload: control is lost, not sent: the old one stays"


async def test_who_sends_no_heartbeats_uploads_nothing(
    bench: Bench, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mqttxt.gateway.control.HEARTBEAT_S", 0.01)
    bench.now_ms += 10_000
    await bench.send(client, count(2))
    assert asked(bench) == []
    async with asyncio.timeout(10):
        while not acks(bench):
            await asyncio.sleep(0.01)
    assert acks(bench) == [(DENIED, 0)]
    assert "no HEARTBEAT" in bench.texts()[0]


async def test_a_first_heartbeat_lets_the_upload_begin(bench: Bench, client: Client) -> None:
    bench.now_ms += 10_000
    await bench.send(client, count(2), count(2))
    assert asked(bench) == []
    bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.settle()
    assert asked(bench) == [0]


async def test_a_drone_of_another_station_gets_no_plan(bench: Bench) -> None:
    bench.drone.holder = "other"
    await upload(bench, bench.client())
    assert (acks(bench), bench.drone.uploads) == ([(DENIED, 0)], [])
    assert bench.texts() == ["controlled by the station other"]


@pytest.mark.parametrize(
    ("error", "result"),
    [
        (ConfigurationError("upload_plan: mqttxt:may/upload-plan is missing"), DENIED),
        (PayloadError("plan: expected at most 61440 bytes before compression, got 70000"), NO_SPACE),
        (TransferFailed("drone 1: plan: not within 300 s"), ERROR),
    ],
)
async def test_what_keeps_a_plan_from_being_carried_is_the_result(bench: Bench, error: Exception, result: int) -> None:
    bench.drone.error = error
    await upload(bench, bench.client())
    assert (acks(bench), bench.texts()) == ([(result, 0)], [f"mission upload: {error}"])


async def test_a_client_that_loses_control_is_told_that_nobody_knows(bench: Bench, client: Client) -> None:
    await upload(bench, client)
    bench.drone.holder, bench.drone.is_controlled = "other", False
    bench.control.on_taken(bench.drone, "other")  # type: ignore[arg-type]
    bench.pass_time(50)
    await bench.settle()
    assert acks(bench) == [(CANCELLED, 0)]
    assert "the drone may have the new list" in bench.texts()[-1]
    meant = list_hash(map(of_plan, range(3)))
    assert bench.copies.mission(client, 1) == meant, "of which the drone says whether it has it"


# Downloads


async def read(bench: Bench, client: Client, kind: int = 0, as_int: bool = True) -> list[Any]:
    """A list, as a client reads it."""
    seen = len(bench.of("MISSION_COUNT"))
    await bench.send(client, wanted(kind))
    number = bench.of("MISSION_COUNT")[seen].count
    request = mavlink.MAVLink_mission_request_int_message if as_int else mavlink.MAVLink_mission_request_message
    before = len(bench.of("MISSION_ITEM_INT" if as_int else "MISSION_ITEM"))
    await bench.send(client, *(request(1, 1, seq, kind) for seq in range(number)))
    return bench.of("MISSION_ITEM_INT" if as_int else "MISSION_ITEM")[before:]


async def test_lists_are_read_from_the_drone_once_and_then_out_of_the_copy(bench: Bench, client: Client) -> None:
    bench.states = (Airframe(PX4, 2), Armed(False))
    bench.drone.plan = Plan(PlanObject(mission=tuple(map(of_plan, range(3))), fence=(), rally=(of_plan(9, 5100),)))
    found = await read(bench, client)
    assert [(one.seq, one.frame, one.current, one.y - 85_455_940) for one in found] == [
        (0, 6, 1, 0),
        (1, 6, 0, 1),
        (2, 6, 0, 2),
    ]
    assert [one.command for one in await read(bench, client, 2)] == [5100]
    assert await read(bench, client, 1) == []
    (old, *_) = await read(bench, client, 0, as_int=False)
    assert (old.frame, old.x) == (3, pytest.approx(47.397742, abs=1e-5))
    assert bench.drone.downloads == 1
    assert not bench.drone.wanted, "nobody controls it, and the gateway has given it up again"


async def test_ardupilots_clients_send_and_read_home_in_front(bench: Bench, client: Client) -> None:
    bench.states = (Airframe(ARDUPILOT, 2), Armed(True), Home(47.0, 8.0, 488.0))
    await bench.send(client, count(3), item(0, command=16, x=0), item(1), item(2))
    (plan, _) = bench.drone.uploads[0]
    assert plan.content.mission == (of_plan(1), of_plan(2))
    await bench.carry(Word.COMPLETED)
    found = await read(bench, client)
    assert [(one.seq, one.frame, one.x) for one in found][:2] == [(0, 5, 470_000_000), (1, 6, 473_977_420)]
    await bench.send(client, count(1), item(0))
    assert bench.drone.uploads[-1][0].content.mission == ()


async def test_a_plan_that_is_not_known_is_not_read_in_the_air_where_nobody_controls_the_drone(
    bench: Bench, client: Client
) -> None:
    bench.drone.plan = Plan(PlanObject(mission=OLD, fence=(), rally=()))
    await bench.send(client, wanted(1))
    assert (acks(bench), bench.of("MISSION_COUNT"), bench.drone.wanted) == ([(DENIED, 1)], [], False)
    assert bench.texts() == ["fence not read: nobody controls the drone, and it is not known to be disarmed"]
    bench.drone.is_controlled = True
    await bench.send(client, wanted(1))
    assert [message.count for message in bench.of("MISSION_COUNT")] == [0]


async def test_where_another_station_controls_the_drone_nothing_is_read_but_the_copy(
    bench: Bench, client: Client
) -> None:
    bench.states, bench.drone.holder = (Airframe(PX4, 2), Armed(False)), "other"
    await bench.send(client, wanted())
    assert (acks(bench), bench.texts()) == ([(DENIED, 0)], ["mission not read: controlled by the station other"])
    bench.copies.put(1, {PlanList.MISSION: OLD})
    await bench.send(client, wanted())
    assert [message.count for message in bench.of("MISSION_COUNT")] == [1]


async def test_a_drone_that_does_not_give_its_plan_is_an_error(bench: Bench) -> None:
    bench.states = (Airframe(PX4, 2), Armed(False))
    await bench.send(bench.client(), wanted())
    assert (acks(bench), bench.texts()) == ([(ERROR, 0)], ["mission not read: drone 1: plan: no_autopilot"])


async def test_who_reads_during_an_upload_gets_the_new_list(bench: Bench, client: Client) -> None:
    bench.copies.put(1, {PlanList.MISSION: OLD})
    await upload(bench, client, 2)
    await bench.send(client, wanted(), wanted())
    assert bench.of("MISSION_COUNT") == []
    await bench.carry(Word.COMPLETED)
    assert [message.count for message in bench.of("MISSION_COUNT")] == [2]


async def test_a_list_that_changes_is_read_on_as_it_was(bench: Bench, client: Client) -> None:
    bench.copies.put(1, {PlanList.MISSION: (of_plan(7), of_plan(8))})
    await bench.send(client, wanted(), mavlink.MAVLink_mission_request_int_message(1, 1, 0, 0))
    bench.copies.put(1, {PlanList.MISSION: OLD})
    await bench.send(client, *(mavlink.MAVLink_mission_request_int_message(1, 1, seq, 0) for seq in (1, 2)))
    assert [found.y - 85_455_940 for found in bench.of("MISSION_ITEM_INT")] == [7, 8]
    assert acks(bench) == [(13, 0)], "an item that the list does not have"
    bench.pass_time(61_000)
    await bench.send(client, mavlink.MAVLink_mission_request_int_message(1, 1, 0, 0))
    assert acks(bench) == [(13, 0)] * 2


async def test_a_copy_is_forgotten_when_the_drone_has_another_mission(bench: Bench, client: Client) -> None:
    bench.copies.name(client, 1, OLD)
    for state, stays in (
        (Mission(1, 0, 1, list_hash(OLD)), True),
        (Airframe(PX4, 2), True),
        (Mission(1, 0, 1, b"of another place"), False),
        (Mission(1, 0, 1), False),
    ):
        bench.copies.put(1, {PlanList.MISSION: OLD, PlanList.FENCE: ()})
        bench.copies.on_state(1, state)
        assert (bench.copies.get(1, PlanList.MISSION) is not None) == stays
        assert (bench.copies.get(1, PlanList.FENCE) is not None) == stays
    assert bench.copies.mission(client, 1) == list_hash(OLD), "what a client means stays, and the drone denies another"
