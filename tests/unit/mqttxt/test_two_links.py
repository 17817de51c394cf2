"""Two connections between a UAV client and its activator (docs/protocol.md, section 19)."""

from __future__ import annotations

from collections import Counter
from random import Random

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.activator.drones import CONTEST_MS
from mqttxt.core.bond import BETTER
from mqttxt.core.effects import Inbound, Publish
from mqttxt.core.hearing import ANSWER_MS, SILENT_MS
from mqttxt.core.mqtt.round_trip import SPARE_S, RoundTrip
from mqttxt.drone.effects import Transmit
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Disarm, Hold
from mqttxt.protocol.control import DroneLease, DroneRecord
from mqttxt.protocol.messages import Word
from mqttxt.security.cose import Envelope
from mqttxt.station.outcomes import Outcome
from tests.simulation.two_links import LINKS, LINKS_TO, NOTICED_MS, TwoLinks
from tests.simulation.world import UAV_SESSION, ack, heartbeat, position

LTE, SAT = LINKS
ARM_DISARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM


def started(**options: object) -> TwoLinks:
    return TwoLinks(**options).start(1000)  # type: ignore[arg-type]


@pytest.fixture
def world() -> TwoLinks:
    return started()


def is_reachable(world: TwoLinks) -> bool:
    payload = world.retained["cloud", "fog1/drone1/reachable"].payload
    return decode(DroneRecord, Envelope.parse(payload).payload if world.signed else payload).up


def records(world: TwoLinks) -> int:
    return sum(publish.topic == "fog1/drone1/reachable" for _, publish in world.sent)


def over(world: TwoLinks, topic: str, since: int = 0) -> list[str]:
    return [publish.link for _, publish in world.over[since:] if publish.topic == topic]


def last_words(world: TwoLinks) -> Counter[object]:
    return Counter(said.id for said in world.heard if isinstance(said, Outcome) and said.is_last)


def words(world: TwoLinks, command_id: object) -> list[Word]:
    return [said.word for said in world.heard if isinstance(said, Outcome) and said.id == command_id and said.is_last]


def written(world: TwoLinks) -> int:
    return sum(isinstance(effect, Transmit) and effect.message.command == ARM_DISARM for effect in world.wrote)


def obey(world: TwoLinks, armed: bool) -> None:
    world.autopilot(ack(ARM_DISARM), heartbeat(armed=armed))


@pytest.mark.parametrize("deaf", [LINKS, LINKS[:1]], ids=["both", "one"])
def test_a_client_connects_anew_where_neither_of_its_connections_delivers(deaf: tuple[str, ...]) -> None:
    world = started()
    for link in deaf:
        world.lose_subscriptions("uav", link)
    world.pass_time(SILENT_MS + ANSWER_MS + 5_000)
    assert [name for name, _ in world.reconnects] == (["uav"] if deaf == LINKS else [])
    assert is_reachable(world)
    command = world.send(Arm())
    world.pass_time(300)
    obey(world, armed=True)
    world.pass_time(300)
    assert words(world, command) == [Word.COMPLETED]
    assert written(world) == 1


@pytest.mark.parametrize("signed", [False, True])
def test_a_drone_is_there_while_one_of_its_connections_is(signed: bool) -> None:
    world = started(signed=signed)
    before = records(world)
    for link in LINKS:
        world.cut("uav", link)
        world.pass_time(2000)
        assert is_reachable(world)
        world.connect("uav", link)
        world.pass_time(2000)
    assert records(world) == before, "nobody hears of a cut of one"
    for link in LINKS:
        world.cut("uav", link)
    world.pass_time(CONTEST_MS)
    assert not is_reachable(world)
    world.connect("uav", SAT)
    world.pass_time(100)
    assert is_reachable(world)


@pytest.mark.parametrize("signed", [False, True])
def test_two_addresses_of_one_broker_are_two_links(signed: bool) -> None:
    world = started(signed=signed, one_broker=True)
    before = records(world)
    for link in LINKS:
        world.cut("uav", link)
        world.pass_time(500)
        command_id = world.send(Hold())
        world.pass_time(2 * CONTEST_MS)
        assert last_words(world)[command_id] == 1
        world.connect("uav", link)
        world.pass_time(1000)
    assert records(world) == before, "the will of one is not the end of the other"
    command_id = world.send(Arm())
    obey(world, True)
    world.pass_time(1000)
    assert written(world) == 1, "what comes over both is executed once"
    assert words(world, command_id) == [Word.COMPLETED]
    for link in LINKS:
        world.cut("uav", link)
    world.pass_time(CONTEST_MS)
    assert not is_reachable(world)


def test_a_will_that_is_repeated_ends_nothing() -> None:
    """A broker may keep a will and say it again, as often as it likes."""
    world = started(signed=True, one_broker=True)
    will = world.uav.will()
    before = records(world)
    for _ in range(50):
        world._at_broker("uav", Publish(LTE, will.topic, will.payload, 1, retain=True))
        world.pass_time(200)
    assert is_reachable(world)
    assert records(world) == before


def test_a_clean_stop_over_one_of_two_ways_to_a_broker_is_the_end() -> None:
    world = started(one_broker=True)
    world.run("uav", world.uav.goodbye(world.now_ms))
    assert not is_reachable(world)


def way_of_states(world: TwoLinks, *altitudes_m: float) -> set[str]:
    """The connections over which the drone's positions leave while it climbs."""
    since = len(world.over)
    for altitude_m in altitudes_m:
        world.autopilot(position(altitude_m))
        world.pass_time(1000)
    return set(over(world, "drone1/state/location", since))


def test_a_better_broker_without_the_activator_carries_nothing_and_is_told_of(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A wrong second address: what goes there is heard by nobody."""
    world = started()
    world.usual_s[SAT] = 0.01
    world.cut("uav", SAT)
    world.cut("activator", SAT)
    world.connect("uav", SAT)
    assert way_of_states(world, *range(30)) == {LTE}
    assert is_reachable(world)
    lte, sat = LINKS_TO[LTE], LINKS_TO[SAT]
    *lost, told = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert lost == [f"fog: one of two connections is lost; {lte} carries all"] * 2
    assert told.startswith(f"fog: {sat} is up but carries nothing: the activator is heard over {lte} alone; expected")
    world.connect("activator", SAT)
    world.pass_time(1000)
    assert way_of_states(world, 50.0) == {SAT}


@pytest.mark.parametrize("act", ["cut", "freeze"])
def test_states_leave_a_broker_from_which_nothing_comes_to_the_activator(world: TwoLinks, act: str) -> None:
    getattr(world, act)("activator", LTE)
    world.autopilot(position(4.0))
    world.pass_time(NOTICED_MS + 1000)
    assert way_of_states(world, 5.0) == {SAT}


def test_the_activator_of_a_wrong_second_broker_gets_neither_answer_nor_end(world: TwoLinks) -> None:
    """It does not become the drone's second activator, and its refusal stops no client."""
    for bound in (True, False):
        since = len(world.over)
        lease = DroneLease(activator_session=0x99, drone_session=UAV_SESSION, nonce=7, bound=bound, epoch=9)
        world.bonds["uav"].received(SAT, Inbound("drone1/init_connect", encode(lease), 1))
        world.pass_time(100)
        assert over(world, "drone1/clock", since) == []
    assert world.stops == []
    assert [log.kind for log in world.logs] == ["other_activator"] * 2
    assert words(world, world.send(Arm())) == []
    assert written(world) == 1


def restart_activator(world: TwoLinks, *links: str) -> None:
    for link in LINKS:
        world.cut("activator", link)
    world.restart_activator(0x77)
    for link in links:
        world.connect("activator", link)


def test_a_restarted_activator_is_taken_over_both(world: TwoLinks) -> None:
    restart_activator(world, LTE, SAT)
    world.pass_time(1000)
    assert is_reachable(world)
    world.send(Arm())
    assert written(world) == 1


def test_a_drone_that_is_there_over_the_lost_connection_alone_is_gone(world: TwoLinks) -> None:
    world.cut("uav", SAT)
    world.cut("activator", LTE)
    assert not is_reachable(world)
    world.connect("activator", LTE)
    world.pass_time(100)
    assert is_reachable(world)


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize(("command", "links"), [(Arm(), [LTE]), (Hold(), [LTE, SAT]), (Disarm(), [LTE, SAT])])
def test_safety_commands_go_over_both(command: object, links: list[str], signed: bool) -> None:
    world = started(signed=signed)
    since = len(world.over)
    world.send(command)
    assert over(world, "drone1/commands", since) == links


def test_a_state_goes_over_the_better_one_alone_and_both_change_with_the_measure(world: TwoLinks) -> None:
    assert way_of_states(world, 5.0) == {LTE}
    world.freeze("uav", LTE)
    world.pass_time(NOTICED_MS + 100)
    assert way_of_states(world, 9.0) == {SAT}
    since = len(world.over)
    world.send(Arm())
    assert over(world, "drone1/commands", since) == [SAT], "the activator follows the drone's beacon"


def test_a_command_that_only_a_stuck_connection_has_goes_over_the_other(world: TwoLinks) -> None:
    world.freeze("uav", LTE)
    command_id = world.send(Arm())
    assert written(world) == 0
    world.pass_time(600)
    assert written(world) == 1
    obey(world, True)
    world.pass_time(100)
    assert words(world, command_id) == [Word.COMPLETED]
    world.thaw("uav", LTE)
    world.pass_time(1000)
    assert written(world) == 1
    assert words(world, command_id) == [Word.COMPLETED]


def test_a_command_that_comes_out_of_a_stuck_connection_after_its_deadline_is_not_executed(world: TwoLinks) -> None:
    for link in LINKS:
        world.freeze("uav", link)
    command_id = world.send(Arm(), ttl_ms=1000)
    world.pass_time(3000)
    for link in LINKS:
        world.thaw("uav", link)
    world.pass_time(1000)
    assert written(world) == 0
    assert words(world, command_id) == [Word.EXPIRED]


def test_an_older_command_does_not_come_behind_a_hold(world: TwoLinks) -> None:
    world.freeze("uav", LTE)
    older = world.send(Arm())
    world.send(Hold())
    world.thaw("uav", LTE)
    world.pass_time(1000)
    assert written(world) == 0
    assert words(world, older) == [Word.OVERTAKEN]


def test_nobody_subscribes_only_where_no_broker_has_a_subscriber(world: TwoLinks) -> None:
    world.lose_subscriptions("uav", LTE)
    command_id = world.send(Arm())
    assert written(world) == 1
    assert words(world, command_id) == []


@pytest.mark.long
@pytest.mark.parametrize("signed", [False, True])
def test_cuts_double_and_lose_nothing(signed: bool) -> None:
    cut_and_flown(50, signed=signed)


@pytest.mark.long
@pytest.mark.soak("services/mqttxt/src/mqttxt", "tests/simulation")
@pytest.mark.timeout(900)
def test_a_thousand_cuts_double_and_lose_nothing() -> None:
    cut_and_flown(1000, signed=False)


def cut_and_flown(cuts: int, *, signed: bool) -> None:
    """Links are cut or frozen while commands fly: each is written once, completed, and no state is away for 1 s."""
    rng = Random(1)
    world = started(signed=signed)
    sent: list[object] = []
    expected_writes, gap_ms, heard_ms = 0, 0, world.now_ms
    for number in range(cuts):
        name, link = rng.choice(("uav", "uav", "activator")), rng.choice(LINKS)
        is_stuck = name == "uav" and rng.random() < 0.5
        command_at, back_at = rng.randrange(8), 12 + rng.randrange(8)
        armed = number % 2 == 0
        for step in range(30):
            before = len(world.wrote)
            if step == 4:
                (world.freeze if is_stuck else world.cut)(name, link)
            if step == command_at:
                sent.append(world.send(Arm() if armed else Disarm()))
                expected_writes += 1
            if step == back_at:
                (world.thaw if is_stuck else world.connect)(name, link)
            world.autopilot(position(5.0 + (number * 30 + step) % 50))
            world.pass_time(50)
            if len(world.wrote) != before:
                obey(world, armed)
            if any(who == "activator" and "/state/location" in each.topic for who, each in world.sent):
                gap_ms, heard_ms = max(gap_ms, world.now_ms - heard_ms), world.now_ms
            world.sent.clear()
            world.over.clear()
        assert is_reachable(world)
    world.pass_time(1000)
    assert written(world) == expected_writes
    assert last_words(world) == Counter(sent)
    assert all(words(world, command_id) == [Word.COMPLETED] for command_id in sent)
    assert gap_ms < 1000


def test_an_overdue_answer_makes_a_connection_stuck_and_a_late_one_makes_it_worse() -> None:
    found = RoundTrip()
    assert found.usual_s(0) > 0
    for _ in range(50):
        found.took(0.05)
    quick = found.usual_s(0)
    assert quick == found.usual_s(quick + SPARE_S / 2)
    assert found.usual_s(quick + 2 * SPARE_S) == float("inf")
    found.took(1.0)
    assert quick < BETTER * found.usual_s(0), "a lost segment is a late answer"
