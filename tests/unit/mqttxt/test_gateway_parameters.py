"""Parameters from drones to clients and back: out of the gateway's copy, by who controls alone (docs/gateway.md)."""

from __future__ import annotations

import asyncio
import math
import struct
from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Airframe, Armed, Drone, Parameters, SetParameter, Word
from mqttxt.drone.mavlink.px4 import Px4
from mqttxt.errors import ConfigurationError, FogUnreachable, TransferFailed
from mqttxt.gateway.clients import Client
from mqttxt.gateway.modes import ARDUPILOT
from mqttxt.gateway.parameter_copies import FRESH_MS
from mqttxt.gateway.parameters import MOST_LISTS, MOST_WAITING, PER_TICK, READINGS
from mqttxt.gateway.settings import MOST_OPEN
from mqttxt.protocol.parameters import Parameter, ParameterSet, ParameterType
from tests.simulation.desk import Bench

INT32, UINT32, REAL32 = ParameterType.INT32, ParameterType.UINT32, ParameterType.REAL32
NOT_THERE, WRONG_VALUE, NOT_ALLOWED = 1, 2, 3
SET = ParameterSet.of(
    [
        *(Parameter("MPC_XY_CRUISE", REAL32, 5.0), Parameter("NAV_DLL_ACT", INT32, 0), Parameter("A_NAN", REAL32)),
        *(Parameter("MIS_TAKEOFF_ALT", REAL32, 2.5), Parameter("RTL_CONE_ANG", INT32, -45)),
    ]
)
LISTED = ["A_NAN", "MIS_TAKEOFF_ALT", "MPC_XY_CRUISE", "NAV_DLL_ACT", "RTL_CONE_ANG"]
LIST = mavlink.MAVLink_param_request_list_message(1, 1)


def read(name: str = "", place: int = -1) -> Any:
    return mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), place)


def set_(name: str, value: float, kind: int = REAL32) -> Any:
    return mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind)


def bytewise(number: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", number))[0])


def whole(message: Any) -> int:
    return int(struct.unpack("<i", struct.pack("<f", message.param_value))[0])


def values(bench: Bench, name: str = "qgc") -> list[Any]:
    return bench.of("PARAM_VALUE", name)


def errors(bench: Bench, name: str = "qgc") -> list[tuple[str, int]]:
    return [(one.param_id, one.error) for one in bench.of("PARAM_ERROR", name)]


@pytest.fixture
def bench(group: asyncio.TaskGroup) -> Bench:
    made = Bench(group)
    made.states = (Airframe(12, 2), Armed(False))
    made.drone.sets = [SET]
    return made


async def test_the_list_begins_with_the_hash_of_what_is_shown_and_each_parameter_has_its_place(bench: Bench) -> None:
    await bench.send(bench.client(), LIST)
    bench.pass_time(50)
    hash_, *listed = values(bench)
    assert [one.param_id for one in listed] == LISTED
    assert [(one.param_index, one.param_count) for one in listed] == [(place, 5) for place in range(5)]
    assert [one.param_type for one in listed] == [REAL32, REAL32, REAL32, INT32, INT32]
    assert math.isnan(listed[0].param_value)
    assert (listed[1].param_value, listed[2].param_value, whole(listed[4])) == (10.0, 5.0, -45)
    shown = ParameterSet.of([*SET, Parameter("MIS_TAKEOFF_ALT", REAL32, 10.0)])
    crc = Px4().hash_check(shown)
    assert (hash_.param_id, hash_.param_type, hash_.param_index) == ("_HASH_CHECK", UINT32, 65_535)
    assert struct.pack("<f", hash_.param_value) == struct.pack("<I", crc or 0)


async def test_an_ardupilots_whole_numbers_are_numbers_and_it_has_no_hash(bench: Bench, client: Client) -> None:
    bench.states = (Airframe(ARDUPILOT, 2), Armed(False))
    bench.drone.sets = [ParameterSet.of([Parameter("RTL_ALT", INT32, 1500), Parameter("WPNAV_SPEED", REAL32, 1000.0)])]
    await bench.send(client, LIST, read("_HASH_CHECK"))
    bench.pass_time(50)
    assert [(one.param_id, one.param_value) for one in values(bench)] == [
        ("MIS_TAKEOFF_ALT", 10.0),
        ("RTL_ALT", 1500.0),
        ("WPNAV_SPEED", 1000.0),
    ]
    assert errors(bench) == [("_HASH_CHECK", NOT_THERE)]
    await bench.send(client, set_("RTL_ALT", 1600.0, REAL32))  # ArduPilot takes any type
    assert bench.drone.commands == [SetParameter("RTL_ALT", 1600)]
    await bench.say(Word.COMPLETED)
    assert (values(bench)[-1].param_value, values(bench)[-1].param_type) == (1600.0, INT32)


async def test_the_set_is_read_once_for_all_who_ask_and_is_a_minute_old_at_most(bench: Bench) -> None:
    first, second = bench.client(), bench.client("mavsdk", 245)
    bench.drone.gate.clear()
    await bench.send(first, LIST, read("MPC_XY_CRUISE"), read("MPC_XY_CRUISE"), LIST)
    await bench.send(second, read("", 4), read("NOBODY"), read("", 5))
    assert values(bench) == values(bench, "mavsdk") == []
    assert bench.drone.is_controlled
    bench.drone.gate.set()
    await bench.settle()
    assert not bench.drone.is_controlled, "nobody commands: control was for the reading"
    bench.pass_time(100)
    assert [one.param_id for one in values(bench)].count("MPC_XY_CRUISE") == 2
    assert [one.param_id for one in values(bench, "mavsdk")] == ["RTL_CONE_ANG"]
    assert errors(bench, "mavsdk") == [("NOBODY", NOT_THERE), ("", NOT_THERE)]
    bench.pass_time(FRESH_MS - 200)
    await bench.send(first, read("", 0))
    assert bench.drone.known == [None]
    bench.pass_time(200)
    await bench.send(first, read("", 0))
    assert bench.drone.known == [None, Parameters(SET)], "what it has goes with the question"


async def test_a_long_list_is_sent_in_turns_and_ends_where_its_client_has_it_already(bench: Bench) -> None:
    bench.drone.sets = [ParameterSet.of(Parameter(f"P{number:04}", REAL32, number) for number in range(1200))]
    client = bench.client()
    await bench.send(client, LIST)
    bench.pass_time(50)
    assert len(values(bench)) == 1 + PER_TICK
    await bench.send(client, set_("_HASH_CHECK", values(bench)[0].param_value, UINT32))
    bench.pass_time(1000)
    assert len(values(bench)) == 1 + PER_TICK
    assert bench.drone.commands == []
    await bench.send(client, LIST)
    bench.pass_time(4000)
    assert [one.param_index for one in values(bench)[2 + PER_TICK :]] == list(range(1201))


async def test_where_the_set_cannot_be_read_a_text_says_why_and_the_list_is_the_gateways_own(bench: Bench) -> None:
    bench.states = (Airframe(12, 2), Armed(True))
    client = bench.client()
    for _ in range(3):
        await bench.send(client, LIST, read("MPC_XY_CRUISE"))
        bench.pass_time(50)
    assert [(one.param_id, one.param_count) for one in values(bench)] == [("MIS_TAKEOFF_ALT", 1)] * 3
    assert bench.texts() == ["parameters not read: nobody controls the drone, and it is not known to be disarmed"]
    assert errors(bench) == []
    bench.states, bench.drone.error = (Airframe(12, 2), Armed(False)), TransferFailed("drone 1: parameters: no_answer")
    bench.pass_time(10_000)
    await bench.send(client, LIST)
    assert bench.texts()[1:] == ["parameters not read: drone 1: parameters: no_answer"]


async def test_a_value_is_answered_only_once_it_was_read_back(bench: Bench, client: Client) -> None:
    await bench.send(client, LIST)
    bench.pass_time(50)
    seen = len(values(bench))
    for _ in range(4):  # as MAVSDK repeats it
        await bench.send(client, set_("NAV_DLL_ACT", bytewise(2), INT32))
        bench.pass_time(500)
        bench.clients.on_heartbeat(client, bench.now_ms)
    await bench.say(Word.ACCEPTED)
    assert (bench.drone.commands, len(values(bench))) == ([SetParameter("NAV_DLL_ACT", 2)], seen)
    await bench.say(Word.COMPLETED)
    answer = values(bench)[seen]
    assert (answer.param_id, whole(answer), answer.param_index, answer.param_count) == ("NAV_DLL_ACT", 2, 3, 5)
    await bench.send(client, set_("NAV_DLL_ACT", bytewise(2), INT32))
    assert (len(values(bench)), len(bench.drone.commands)) == (seen + 2, 1), "a repetition a moment later"
    await bench.send(client, read("NAV_DLL_ACT"))
    assert (whole(values(bench)[-1]), bench.drone.known) == (2, [None]), "the copy has it"
    await bench.send(client, set_("NAV_DLL_ACT", bytewise(0), INT32), set_("NAV_DLL_ACT", bytewise(2), INT32))
    assert len(bench.drone.commands) == 3, "another value between: it is no repetition"


async def test_a_value_that_was_set_before_anything_was_read_has_no_number_of_parameters(bench: Bench) -> None:
    await bench.send(bench.client(), set_("MPC_XY_CRUISE", 6.0))
    await bench.say(Word.COMPLETED)
    (answer,) = values(bench)
    assert (answer.param_id, answer.param_value, answer.param_count, answer.param_index) == (
        *("MPC_XY_CRUISE", 6.0),
        *(65_535, 0),
    )
    assert bench.drone.known == []


@pytest.mark.parametrize(
    ("word", "reason", "error"),
    [
        (Word.DENIED, "parameter_not_enabled", NOT_ALLOWED),
        (Word.DENIED, "not_allowed, mqttxt:may/set-parameters", NOT_ALLOWED),
        (Word.DENIED, "unknown_parameter", NOT_THERE),
        (Word.DENIED, "wrong_value, a whole number from 0 to 255", WRONG_VALUE),
        (Word.DENIED, "out_of_range, 1 to 20", WRONG_VALUE),
        (Word.FAILED, "is 5", None),
        (Word.EXPIRED, None, None),
        (Word.UNCONFIRMED, "no_ack", None),
    ],
)
async def test_a_no_is_an_error_and_never_a_value(
    bench: Bench, word: Word, reason: str | None, error: int | None, client: Client
) -> None:
    await bench.send(client, LIST)
    bench.pass_time(50)
    seen = len(values(bench))
    await bench.send(client, set_("CBRK_SUPPLY_CHK", 6.0))
    await bench.say(word, reason=reason)
    await bench.send(client, set_("CBRK_SUPPLY_CHK", 6.0))
    assert len(bench.drone.commands) == 1, "the repetition has the same answer"
    assert errors(bench) == ([] if error is None else [("CBRK_SUPPLY_CHK", error)] * 2)
    assert len(values(bench)) == seen
    assert bench.texts() == [f"CBRK_SUPPLY_CHK not set: {word.label}{f'({reason})' if reason else ''}"]
    await bench.send(client, read("NAV_DLL_ACT"))
    assert len(bench.drone.known) == (2 if word in (Word.FAILED, Word.UNCONFIRMED) else 1)


async def test_who_does_not_control_sets_nothing(bench: Bench) -> None:
    first, second = bench.client(), bench.client("mavsdk", 245)
    await bench.send(first, set_("MPC_XY_CRUISE", 6.0))
    await bench.send(second, set_("MPC_XY_CRUISE", 7.0))
    assert (errors(bench, "mavsdk"), len(bench.drone.commands)) == ([("MPC_XY_CRUISE", NOT_ALLOWED)], 1)
    assert bench.texts("mavsdk") == ["MPC_XY_CRUISE not set: controlled by system 255 at qgc"]


@pytest.mark.parametrize(
    ("error", "answer"),
    [
        (ConfigurationError("gs's certificate lacks mqttxt:may/set-parameters"), [("MPC_XY_CRUISE", NOT_ALLOWED)]),
        (FogUnreachable("fog 1 is not live"), []),
    ],
)
async def test_what_cannot_be_sent_is_told(bench: Bench, error: Exception, answer: list[Any]) -> None:
    bench.drone.error = error
    await bench.send(bench.client(), set_("MPC_XY_CRUISE", 6.0))
    assert (errors(bench), bench.texts()) == (answer, [f"MPC_XY_CRUISE not set: {error}"])


async def test_a_value_that_is_no_number_of_its_type_is_refused_at_once(bench: Bench) -> None:
    await bench.send(bench.client(), set_("MPC_XY_CRUISE", math.nan), set_("MPC_XY_CRUISE", 1.0, 10))
    assert (errors(bench), bench.drone.commands) == ([("MPC_XY_CRUISE", WRONG_VALUE)] * 2, [])


async def test_the_takeoff_altitude_is_the_gateways_own(bench: Bench, client: Client) -> None:
    await bench.send(client, read("MIS_TAKEOFF_ALT"), set_("MIS_TAKEOFF_ALT", 25.0))
    assert [(one.param_value, one.param_index) for one in values(bench)] == [(10.0, 0), (25.0, 0)]
    await bench.send(client, set_("MIS_TAKEOFF_ALT", 0.1))
    assert (errors(bench), bench.drone.commands, bench.drone.known) == ([("MIS_TAKEOFF_ALT", WRONG_VALUE)], [], [])
    assert (bench.parameter_copies.takeoff_m(1), bench.parameter_copies.takeoff_m(2)) == (25.0, 10.0)
    await bench.send(client, LIST, read("MIS_TAKEOFF_ALT"))
    assert (values(bench)[-1].param_value, values(bench)[-1].param_index) == (25.0, 1)


async def test_who_does_not_control_changes_no_takeoff_altitude(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mqttxt.gateway.control.HEARTBEAT_S", 0.001)
    pilot, watcher = bench.client(), bench.client("watcher", 200)
    silent = Client(bench.client("silent").peer, 201, 190)
    await bench.send(pilot, LIST, set_("MPC_XY_CRUISE", 6.0))
    await bench.send(watcher, set_("MIS_TAKEOFF_ALT", 10_000.0))
    await bench.send(silent, set_("MIS_TAKEOFF_ALT", 10_000.0))
    await asyncio.sleep(0.01)
    await bench.settle()
    assert errors(bench, "watcher") == errors(bench, "silent") == [("MIS_TAKEOFF_ALT", NOT_ALLOWED)]
    assert bench.texts("watcher") == ["MIS_TAKEOFF_ALT not set: controlled by system 255 at qgc"]
    assert "no HEARTBEAT from system 201" in bench.texts("silent")[0]
    assert bench.parameter_copies.takeoff_m(1) == 10.0


async def test_a_takeoff_altitude_that_is_set_is_shown_to_all_who_may_have_the_list(bench: Bench) -> None:
    client, other = bench.client(), bench.client("mavsdk", 245)
    await bench.send(client, set_("MIS_TAKEOFF_ALT", 25.0))
    assert (len(values(bench)), values(bench, "mavsdk")) == (1, []), "a value without its place misleads who waits"
    await bench.send(other, LIST)
    bench.pass_time(100)
    seen = len(values(bench, "mavsdk"))
    await bench.send(client, set_("MIS_TAKEOFF_ALT", 30.0))
    (shown,) = values(bench, "mavsdk")[seen:]
    assert (shown.param_value, shown.param_index, shown.param_count) == (30.0, 1, 5)
    assert [one.param_value for one in values(bench)] == [25.0, 30.0]


async def test_a_client_that_asks_for_ever_is_not_kept_for_ever(bench: Bench, client: Client) -> None:
    bench.drone.gate.clear()
    await bench.send(client, *(read("", place) for place in range(MOST_WAITING + 50)))
    bench.drone.gate.set()
    await bench.settle()
    assert len(values(bench)) + len(errors(bench)) == MOST_WAITING
    await bench.send(client, *(set_("MPC_XY_CRUISE", 1.0 + number) for number in range(MOST_OPEN + 50)))
    assert len(bench.drone.commands) == MOST_OPEN


async def test_a_plan_and_parameters_that_are_read_at_once_have_control_until_both_are_there(bench: Bench) -> None:
    bench.drone.gate.clear()
    client = bench.client()
    await bench.send(client, LIST, mavlink.MAVLink_mission_request_list_message(1, 1, 0))
    assert bench.texts() == ["mission not read: drone 1: plan: no_autopilot"]
    assert bench.drone.is_controlled
    bench.drone.gate.set()
    await bench.settle()
    assert not bench.drone.is_controlled


async def test_a_client_that_takes_control_while_parameters_are_read_holds_it_itself(bench: Bench) -> None:
    """Its silence is to end control, whatever is still read: the autopilot has to notice that nobody is there."""
    bench.drone.gate.clear()
    client = bench.client()
    await bench.send(client, LIST, set_("MPC_XY_CRUISE", 6.0))
    bench.control.review(cast(Drone, bench.drone), Armed(False))
    assert bench.drone.is_controlled
    bench.now_ms += 3001
    bench.control.review(cast(Drone, bench.drone), Armed(False))
    assert not bench.drone.is_controlled
    bench.drone.gate.set()


async def test_a_value_that_is_set_while_the_set_is_read_is_not_lost_to_what_was_read_before(bench: Bench) -> None:
    """The drone gave the set before it had the value; its last word overtakes the set."""
    client = bench.client()
    bench.drone.gate.clear()
    await bench.send(client, set_("MPC_XY_CRUISE", 6.0), LIST)
    await bench.say(Word.COMPLETED)
    bench.drone.sets = [SET, SET.with_one(Parameter("MPC_XY_CRUISE", REAL32, 6.0))]
    bench.drone.gate.set()
    await bench.settle()
    bench.pass_time(100)
    assert [one.param_value for one in values(bench) if one.param_id == "MPC_XY_CRUISE"] == [6.0, 6.0]
    assert bench.drone.known == [None, Parameters(bench.drone.sets[0])]


async def test_no_list_that_is_under_way_has_a_value_from_before_a_set(bench: Bench, client: Client) -> None:
    """Nor where the whole set is read once more meanwhile, and was given before the drone had the value."""
    content = ParameterSet.of(Parameter(f"P{number:04}", REAL32, number) for number in range(200))
    bench.drone.sets = [content, content, content.with_one(Parameter("P0150", REAL32, 7.0))]
    await bench.send(client, LIST)
    bench.pass_time(50)
    bench.drone.gate.clear()
    bench.parameter_copies.forget(1)
    await bench.send(client, read("P0000"), set_("P0150", 7.0), set_("MIS_TAKEOFF_ALT", 20.0))
    await bench.say(Word.COMPLETED)
    bench.drone.gate.set()
    await bench.settle()
    bench.pass_time(1000)
    assert [one.param_value for one in values(bench) if one.param_id == "P0150"] == [7.0, 7.0]
    assert [one.param_value for one in values(bench) if one.param_id == "MIS_TAKEOFF_ALT"] == [10.0, 20.0]


async def test_a_set_that_changes_at_each_reading_is_answered_with_what_was_set_last(bench: Bench) -> None:
    async def change(known: Parameters | None, *, timeout_s: float) -> Parameters:
        gates.append(asyncio.Event())
        await gates[-1].wait()
        return Parameters(SET)

    gates: list[asyncio.Event] = []
    bench.drone.parameters = change  # type: ignore[method-assign]
    client = bench.client()
    await bench.send(client, read("MPC_XY_CRUISE"))
    for number in range(READINGS):
        await bench.send(client, set_("MPC_XY_CRUISE", 6.0 + number))
        await bench.say(Word.COMPLETED)
        gates[number].set()
        await bench.settle()
    assert [one.param_value for one in values(bench)] == [6.0, 7.0, 8.0, 8.0]


async def test_a_last_word_behind_that_of_a_later_value_changes_nothing(bench: Bench, client: Client) -> None:
    await bench.send(client, LIST)
    bench.pass_time(50)
    seen = len(values(bench))
    await bench.send(client, set_("MPC_XY_CRUISE", 6.0), set_("MPC_XY_CRUISE", 7.0))
    await bench.say(Word.COMPLETED, 1)
    await bench.say(Word.COMPLETED, 0)
    await bench.send(client, read("MPC_XY_CRUISE"))
    assert [one.param_value for one in values(bench)[seen:]] == [7.0, 7.0]
    assert bench.texts() == ["MPC_XY_CRUISE not set: a later value was set"]


async def test_a_set_that_may_be_anothers_whenever_it_is_read_counts_for_one_answer(bench: Bench) -> None:
    async def change(known: Parameters | None, *, timeout_s: float) -> Parameters:
        bench.parameter_copies.forget(1)
        readings.append(known)
        return Parameters(SET)

    readings: list[Parameters | None] = []
    bench.drone.parameters = change  # type: ignore[method-assign]
    await bench.send(bench.client(), read("MPC_XY_CRUISE"))
    assert (len(values(bench)), len(readings)) == (1, READINGS)
    await bench.send(bench.client(), read("MPC_XY_CRUISE"))
    assert len(readings) == 2 * READINGS


async def test_a_drone_that_comes_back_as_another_autopilot_is_shown_as_that_one(bench: Bench, client: Client) -> None:
    await bench.send(client, read("RTL_CONE_ANG"))
    bench.states = (Airframe(ARDUPILOT, 2), Armed(False))
    await bench.send(client, read("RTL_CONE_ANG"))
    assert (whole(values(bench)[0]), values(bench)[1].param_value) == (-45, -45.0)


async def test_lists_share_what_is_sent_at_a_time(bench: Bench) -> None:
    """So that whoever asks for many keeps no command waiting."""
    bench.drone.sets = [ParameterSet.of(Parameter(f"P{number:04}", REAL32, number) for number in range(100))]
    clients = [bench.client(f"client{number}", 100 + number) for number in range(MOST_LISTS + 5)]
    for client in clients:
        await bench.send(client, LIST)
    before = [len(values(bench, client.peer.name)) for client in clients]
    bench.pass_time(50)
    sent = [len(values(bench, client.peer.name)) - number for client, number in zip(clients, before, strict=True)]
    assert sent == [1] * MOST_LISTS + [0] * 5


@pytest.mark.parametrize("armed", [Armed(True), None])
async def test_a_drone_that_is_armed_while_parameters_are_read_is_not_held_by_that(
    bench: Bench, armed: Armed | None
) -> None:
    bench.drone.gate.clear()
    await bench.send(bench.client(), LIST)
    drone = cast(Drone, bench.drone)
    bench.control.review(drone, Armed(False))
    assert drone.is_controlled
    bench.control.review(drone, armed)
    assert not drone.is_controlled
    bench.drone.gate.set()
