"""Plans of several clients, and of one that connects anew: each starts the mission that it means (docs/gateway.md)."""

from __future__ import annotations

from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Airframe, Arm, Armed, Drone, Mission, StartMission, Word
from mqttxt.gateway.clients import Client
from mqttxt.gateway.downloads import KEPT_MS, MOST_READINGS, MOST_WAITING
from mqttxt.gateway.modes import ARDUPILOT
from mqttxt.protocol.plans import PlanList, list_hash
from tests.simulation.desk import Bench
from tests.unit.mqttxt.test_gateway_plans import (
    ACCEPTED,
    ARM,
    ERROR,
    OLD,
    START,
    acks,
    asked,
    clear,
    count,
    item,
    of_plan,
    upload,
    wanted,
)

NEW = list_hash(map(of_plan, range(3)))


def requested(seq: int) -> Any:
    return mavlink.MAVLink_mission_request_int_message(1, 1, seq, 0)


async def accepted_and_failed(bench: Bench, client: Client) -> None:
    """A mission of a client is ACCEPTED, and the drone does not take it."""
    bench.clients.on_heartbeat(client, bench.now_ms)
    await upload(bench, client)
    bench.pass_time(1100)
    await bench.carry(Word.FAILED, reason="timeout")
    bench.clients.on_heartbeat(client, bench.now_ms)


@pytest.fixture
def bench(group: Any) -> Bench:
    """A drone that has another mission than the one that is uploaded."""
    made = Bench(group, take_over=True)
    made.states = (*made.states, Mission(1, 0, 1, list_hash(OLD)))
    return made


@pytest.mark.parametrize("word", [Word.COMPLETED, Word.FAILED])
async def test_a_start_names_the_mission_that_its_own_client_has_read(bench: Bench, word: Word) -> None:
    bench.copies.put(1, {PlanList.MISSION: OLD})
    first, second = bench.client(), bench.client("script", 245)
    await bench.send(second, wanted())
    await upload(bench, first)
    await bench.carry(word)
    await bench.ask(second, START)
    assert bench.drone.commands == [StartMission(list_hash(OLD), 1)], "which the drone denies if it has another"
    await bench.ask(first, START)
    assert bench.drone.commands[1:] == [StartMission(NEW, 1)]


async def test_a_client_that_has_neither_read_nor_uploaded_means_the_drones_mission(bench: Bench) -> None:
    await upload(bench, bench.client())
    await bench.carry(Word.COMPLETED)
    await bench.ask(bench.client("script", 245), START)
    assert bench.drone.commands == [StartMission(list_hash(OLD), 1)]


@pytest.mark.parametrize("system", [255, 254])
@pytest.mark.parametrize("request_", [ARM, START])
async def test_a_client_that_connects_anew_does_not_fly_the_mission_before_its_own(
    bench: Bench, system: int, request_: Any
) -> None:
    """Its upload was ACCEPTED when its connection broke; the drone still has the old mission."""
    client = bench.client("tcp:1")
    await upload(bench, client)
    bench.pass_time(1100)
    assert acks(bench, "tcp:1") == [(ACCEPTED, 0)]
    bench.clients.on_gone(client.peer)
    bench.pass_time(100)
    await bench.settle()
    again = bench.client("tcp:2", system)
    await bench.ask(again, request_)
    assert bench.acks("tcp:2") == [(request_.mav_cmd, 2)]
    assert bench.drone.commands == []
    assert bench.texts("tcp:2")[0].endswith("upload it again, clear it, or read what the drone has")
    bench.copies.put(1, {PlanList.MISSION: OLD})
    await bench.send(again, wanted())
    bench.pass_time(1100)
    await bench.ask(again, request_)
    assert bench.drone.commands == [Arm() if request_ is ARM else StartMission(list_hash(OLD), 1)]


async def test_each_client_whose_list_failed_has_to_learn_what_the_drone_has(bench: Bench) -> None:
    first, second = bench.client(), bench.client("script", 245)
    for client in (first, second):
        await accepted_and_failed(bench, client)
    bench.copies.put(1, {PlanList.MISSION: OLD})
    await bench.send(second, wanted())
    await bench.ask(first, ARM)
    assert (bench.acks(), bench.drone.commands) == ([(400, 2)], [])
    await bench.ask(second, ARM)
    assert bench.drone.commands == [Arm()]


async def test_a_failed_list_counts_for_every_client_until_one_learns_what_the_drone_has(bench: Bench) -> None:
    first, second, third = bench.client(), bench.client("script", 245), bench.client("other", 246)
    await accepted_and_failed(bench, first)
    for client in (second, third):
        bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.ask(second, ARM)
    assert (bench.acks("script"), bench.drone.commands) == ([(400, 2)], [])
    bench.copies.put(1, {PlanList.MISSION: OLD})
    await bench.send(third, wanted())
    bench.pass_time(1100)
    await bench.ask(second, ARM)
    assert bench.drone.commands == [Arm()]


async def test_without_a_kind_of_autopilot_no_list_is_guessed(group: Any) -> None:
    """With ArduPilot item 0 is home, no item of the plan."""
    bench = Bench(group)
    client = bench.client()
    bench.states = (Armed(False),)
    bench.copies.put(1, {PlanList.MISSION: OLD})
    await bench.send(client, count(3), item(0, x=0), item(1), item(2), wanted())
    assert (asked(bench), bench.of("MISSION_COUNT"), bench.drone.uploads) == ([], [], [])
    why = "the kind of the drone's autopilot is not known yet"
    assert (acks(bench), bench.texts()) == ([(ERROR, 0)] * 2, [why, f"mission not read: {why}"])
    bench.states = (Airframe(ARDUPILOT, 2), Armed(False))
    await bench.send(client, count(3), item(0, x=0), item(1), item(2))
    assert bench.drone.uploads[0][0].content.mission == (of_plan(1), of_plan(2))


async def test_lists_that_are_sent_while_another_is_carried_do_not_pile_up(group: Any) -> None:
    """The drone is away: the list that is carried takes up to 300 s, and then each one behind it."""
    bench = Bench(group)
    client = bench.client()
    for number in range(1, 11):
        await upload(bench, client, number)
        bench.pass_time(1100)
        bench.clients.on_heartbeat(client, bench.now_ms)
    assert acks(bench) == [(ACCEPTED, 0)] * 10
    assert bench.texts() == ["mission upload: a newer list replaces it"] * 8
    await bench.carry(Word.COMPLETED)
    await bench.carry(Word.COMPLETED)
    assert [len(plan.content.mission or ()) for plan, _ in bench.drone.uploads] == [1, 10]
    assert bench.texts()[8:] == ["mission upload completed: 1 items", "mission upload completed: 10 items"]


async def test_a_list_that_is_replaced_before_its_acknowledgement_gets_none(group: Any) -> None:
    """Its client would take it for the newer one's."""
    bench = Bench(group)
    client = bench.client()
    await upload(bench, client, 1)
    await upload(bench, client, 2)
    await bench.send(client, clear(1))
    await upload(bench, client, 3)
    await bench.carry(Word.COMPLETED)
    await bench.carry(Word.COMPLETED)
    assert acks(bench) == [(ACCEPTED, 0), (ACCEPTED, 1), (ACCEPTED, 0)]
    assert bench.copies.mission(client, 1) == NEW


async def test_strangers_lists_are_bounded_and_one_copy_serves_all(group: Any) -> None:
    """Whoever reads needs no HEARTBEAT, and one socket may have every id."""
    bench = Bench(group)
    bench.copies.put(1, {PlanList.MISSION: tuple(map(of_plan, range(3)))})
    reader = bench.client()
    await bench.send(reader, wanted())
    strangers = [Client(reader.peer, 1 + number, 190) for number in range(MOST_READINGS + 20)]
    for client in strangers:
        bench.now_ms += 1
        await bench.send(reader, requested(0))
        await bench.send(client, wanted())
    readings = bench.missions._downloads._readings
    assert len(readings) == MOST_READINGS
    assert len({id(reading.items) for reading in readings.values()}) == 1
    assert len(bench.of("MISSION_ITEM_INT")) == len(strangers), "who reads on is not the one that makes room"
    bench.pass_time(KEPT_MS + 100)
    assert readings is not bench.missions._downloads._readings
    assert bench.missions._downloads._readings == {}


async def test_strangers_who_wait_for_a_plan_are_bounded(group: Any) -> None:
    bench = Bench(group)
    peer = bench.client().peer
    for number in range(MOST_WAITING + 50):
        client = Client(peer, 1 + number % 255, number // 255)
        bench.missions._downloads.on_list(client, cast(Drone, bench.drone), PlanList.MISSION)
    await bench.settle()
    assert len(acks(bench)) == MOST_WAITING
