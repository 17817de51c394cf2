"""`mavlink`: any MAV_CMD as it is, within limits, once (section 5)."""

from __future__ import annotations

import math

import cbor2
import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.effects import Inbound
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import Transmit
from mqttxt.drone.executor import Executor
from mqttxt.drone.mavlink.raw import GUARDED, MAV_CMDS, PASSED, TYPED, Limits
from mqttxt.drone.options import UavOptions
from mqttxt.drone.role import UavClient
from mqttxt.errors import ConfigurationError, PayloadError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Mavlink
from mqttxt.protocol.messages import CommandMessage, Word
from mqttxt.protocol.values import Encoding
from mqttxt.station.outcomes import Outcome
from tests.simulation.workbench import Bench, said, written
from tests.simulation.world import UAV_SESSION, World, ack, command_payload, from_autopilot, on_disk, ready

NAN = math.nan
ROI, REBOOT = 195, 246


def raw(number: int, *params: float | None, component: int | None = None) -> Mavlink:
    return Mavlink(number, (*params, *[0.0] * (7 - len(params))), component)


class Raw(Bench):
    def __init__(self, limits: Limits) -> None:
        super().__init__()
        self.executor = Executor(self.vehicle, limits)


def test_it_is_a_command_long_to_the_autopilot_with_nan_where_nothing_is_set() -> None:
    (out,) = Bench().start(1, raw(ROI, 1.5, None, NAN))
    assert isinstance(out, Transmit)
    sent = out.message
    assert (sent.get_type(), sent.command, sent.target_system, sent.target_component) == ("COMMAND_LONG", ROI, 1, 1)
    assert (sent.param1, sent.confirmation) == (1.5, 0)
    assert math.isnan(sent.param2)
    assert math.isnan(sent.param3)


def test_it_is_never_repeated() -> None:
    bench = Bench()
    out = [*bench.start(1, raw(ROI)), *bench.until(5000)]
    assert written(out) == [ROI]
    assert said(out) == [(1, Word.UNCONFIRMED, "no_ack")]


def test_of_one_number_one_is_open_and_none_supersedes_another() -> None:
    bench = Bench()
    bench.start(1, raw(ROI, 1.0))
    assert bench.start(2, raw(ROI, 2.0)) == []
    assert bench.start(3, raw(ROI, 3.0)) == []
    bench.hear(ack(ROI))
    assert [o.message.param1 for o in bench.until(100)] == [2.0]
    bench.hear(ack(ROI))
    assert [o.message.param1 for o in bench.until(200)] == [3.0]


@pytest.mark.parametrize(("result", "word"), [(2, Word.DENIED), (3, Word.UNSUPPORTED), (4, Word.FAILED)])
def test_the_autopilots_refusal_is_the_last_word(result: int, word: Word) -> None:
    bench = Bench()
    bench.start(1, raw(ROI))
    assert [w for _, w, _ in said(bench.refuse(ack(ROI, result)))] == [word]


@pytest.mark.parametrize("number", sorted(TYPED))
def test_what_has_a_form_of_its_own_is_denied_even_where_it_is_allowed(number: int) -> None:
    ((_, word, reason),) = said(Raw(Limits(frozenset({number}))).start(1, raw(number, 1.0)))
    assert (word, reason) == (Word.DENIED, f"use_typed_command, {TYPED[number]}")


def test_a_plain_disarm_has_a_form_of_its_own() -> None:
    assert said(Bench().start(1, raw(400, 0.0))) == [(1, Word.DENIED, "use_typed_command, disarm")]


@pytest.mark.parametrize("number", sorted(GUARDED))
def test_what_is_dangerous_is_denied_unless_it_was_allowed(number: int) -> None:
    command = raw(number, 0.0, 21196.0)
    assert said(Bench().start(1, command)) == [(1, Word.DENIED, "mav_cmd_not_enabled")]
    assert written(Raw(Limits(frozenset({number}))).start(1, command)) == [number]


@pytest.mark.parametrize("number", [0, 43004, 65_535])
def test_what_is_not_in_common_is_denied(number: int) -> None:
    assert number not in MAV_CMDS
    assert said(Bench().start(1, raw(number))) == [(1, Word.DENIED, "unknown_mav_cmd")]


def test_another_component_has_to_be_allowed_and_answers_itself() -> None:
    command = raw(ROI, component=100)
    assert said(Bench().start(1, command)) == [(1, Word.DENIED, "component_not_enabled")]
    bench = Raw(Limits(components=frozenset({100})))
    (out,) = bench.start(1, command)
    assert out.message.target_component == 100
    assert bench.hear(ack(ROI)) == []
    camera = from_autopilot(mavlink.MAVLink_command_ack_message(ROI, 0, 0, 0, 1, 191), component=100)
    assert [w for _, w, _ in said(bench.hear(camera))] == [Word.COMPLETED]


@pytest.mark.parametrize(("system", "target"), [(2, (1, 191)), (1, (255, 190)), (1, (1, 100))])
def test_an_acknowledgement_for_somebody_else_is_not_ours(system: int, target: tuple[int, int]) -> None:
    bench = Bench()
    bench.start(1, raw(ROI))
    foreign = mavlink.MAVLink_command_ack_message(ROI, 0, 0, 0, *target)
    assert bench.hear(from_autopilot(foreign, system)) == []


def test_parameters_are_seven_numbers_or_nothing() -> None:
    assert raw(ROI, NAN) == raw(ROI, None)
    with pytest.raises(PayloadError, match="expected 7"):
        Mavlink(ROI, (1.0,))
    with pytest.raises(PayloadError):
        encode(command_payload(raw(ROI, math.inf)))
    for plain in ([1, 2], [math.inf, *[0] * 6], [math.nan, *[0] * 6], [1e39, *[0] * 6], ["1", *[0] * 6], [0] * 8):
        with pytest.raises(PayloadError):
            decode(CommandMessage, cbor2.dumps([1, 1, 2, 3, 4, 50, 0, 10, ROI, plain]))


@pytest.mark.parametrize("encoding", list(Encoding))
def test_not_set_is_null_on_the_wire(encoding: Encoding) -> None:
    message = command_payload(raw(ROI, NAN, 47.5))
    assert decode(CommandMessage, encode(message, encoding)) == message
    assert cbor2.loads(encode(message))[-2:] == [ROI, [None, 47.5, 0, 0, 0, 0, 0]]


def test_a_ground_station_hears_that_nobody_observed_the_effect() -> None:
    world = World().start(1000)
    world.send(raw(ROI))
    world.autopilot(ack(ROI))
    (outcome,) = [event for event in world.heard if isinstance(event, Outcome)]
    assert (outcome.word, outcome.observed) == (Word.COMPLETED, False)
    assert str(outcome).endswith("completed, effect not observed")


@pytest.mark.parametrize("limits", [Limits(frozenset({ROI})), Limits(components=frozenset({191}))])
def test_an_allowance_that_allows_nothing_is_one_line(limits: Limits) -> None:
    with pytest.raises(ConfigurationError, match="--allow"):
        UavOptions(limits=limits)


@pytest.mark.parametrize("number", sorted(MAV_CMDS))
def test_what_becomes_of_each_mav_cmd_is_decided_on_purpose(number: int) -> None:
    assert (number in PASSED) + (number in {*GUARDED, *TYPED}) == 1, MAV_CMDS[number]
    out = Bench().start(1, raw(number))
    assert written(out) == ([number] if number in PASSED else []), MAV_CMDS[number]


def test_what_is_decided_is_in_common() -> None:
    assert {*GUARDED, *TYPED, *PASSED} == MAV_CMDS.keys()
    assert GUARDED.keys() & TYPED.keys() == {mavlink.MAV_CMD_COMPONENT_ARM_DISARM}


def test_what_has_a_place_passes_only_where_it_does_not_fly_there() -> None:
    placed = {MAV_CMDS[n].removeprefix("MAV_CMD_") for n in PASSED if mavlink.enums["MAV_CMD"][n].has_location}
    assert placed <= {"NAV_ROI", "DO_SET_ROI", "DO_SET_ROI_LOCATION", "DO_SET_HOME"}


@pytest.mark.parametrize("word", ["TAKEOFF", "LAND", "MODE", "ARM", "LOITER", "ORBIT", "MISSION", "RETURN"])
def test_what_names_a_flight_passes_only_where_it_is_none(word: str) -> None:
    named = {name for n, name in MAV_CMDS.items() if n in PASSED and word in name.split("_")}
    assert named <= {"MAV_CMD_SET_CAMERA_MODE"}


def test_a_reboot_that_is_allowed_at_the_uav_client_passes() -> None:
    uav = UavClient(1, UAV_SESSION, Settings(), options=UavOptions(limits=Limits(frozenset({REBOOT}))))
    ready(uav)
    wanted = Inbound("drone1/commands", encode(command_payload(raw(REBOOT, 1.0))), 1)
    effects = on_disk(uav, uav.on_message("fog", wanted, 0), 0)
    assert [e.message.command for e in effects if isinstance(e, Transmit)] == [REBOOT]
