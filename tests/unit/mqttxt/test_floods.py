"""What one client with valid credentials cannot do to the others (section 15)."""

from __future__ import annotations

from typing import Any

import cbor2
import pytest

from mqttxt.activator import command_relay
from mqttxt.activator.role import PRESENCE_AT_ONCE
from mqttxt.activator.stations import BIRTHS_AT_ONCE
from mqttxt.core.channel import Channel
from mqttxt.core.effects import Inbound, Log, Publish
from mqttxt.core.floods import MOST_KNOWN, PAUSE_MS, STATION_AT_ONCE, STATION_PER_S, Repetitions, TokenBucket
from mqttxt.core.ledger import CAPACITY
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import Acknowledge, Journal, StoreReading
from mqttxt.drone.role import UavClient
from mqttxt.drone.sensors.carrier import SENSOR_AT_ONCE, Carrier
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Goto, Hold, Land, Return
from mqttxt.protocol.control import Registration
from mqttxt.protocol.messages import CommandId, Presence, ResultMessage, Word
from mqttxt.protocol.readings import ReadingAck, ReadingMessage
from mqttxt.protocol.topics import FogSide
from mqttxt.security.seal import Seal
from tests.simulation.carrying import reading
from tests.simulation.fogs import ActivatorBench, of, words
from tests.simulation.signing import seal
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION, World, ack, command_payload, heartbeat, ready

ONE, TWO = CommandId(1, 1), CommandId(1, 2)


@pytest.fixture(params=[False, True], ids=["plain", "signed"])
def world(request: pytest.FixtureRequest) -> World:
    made = World(signed=request.param).start()
    made.pass_time(1000)
    return made


def answers(effects: list[Any]) -> list[Publish]:
    return [effect for effect in effects if isinstance(effect, Publish) and "/commands_result/" in effect.topic]


def last_command(world: World, by: str) -> Inbound:
    publish = [sent for name, sent in world.sent if name == by and sent.topic.endswith("/commands")][-1]
    return Inbound(publish.topic, publish.payload, 1)


@pytest.mark.parametrize(("name", "link", "by"), [("activator", "cloud", "gs"), ("uav", "fog", "activator")])
def test_an_id_is_answered_once_a_second_with_the_bytes_of_before(
    world: World, monkeypatch: pytest.MonkeyPatch, name: str, link: str, by: str
) -> None:
    world.send(Arm())
    world.autopilot(ack(400), heartbeat(armed=True))
    said = [sent for role, sent in world.sent if role == name and "/commands_result/" in sent.topic][-1]
    again, role = last_command(world, by), getattr(world, name)
    commands = world.activator.relay if name == "activator" else world.uav.desk
    monkeypatch.setattr(Seal, "sign", lambda *_: pytest.fail("signed anew"))
    heard = []
    for _ in range(300):
        world.now_ms += 10
        heard += answers([*role.on_message(link, again, world.now_ms), *commands.tick(world.now_ms)])
    assert {answer.payload for answer in heard} == {said.payload}
    assert len(heard) in (3, 4)


def test_repetitions_of_what_concerns_many_drones_are_answered_in_a_stations_share() -> None:
    """A few of them each second would have the fog say more words than its link takes, and words of others wait."""
    bench = ActivatorBench(drones=tuple(range(1, 101)))
    bench.register(name="eve", session=EVE, lease_s=3600, drones=(1,))
    deadline_ms = bench.now_ms + 5000

    def ask(seq: int) -> list[Publish]:
        return answers(bench.command(to="commands", gs_session=EVE, seq=seq, deadline_ms=deadline_ms))

    first = {(publish.topic, publish.payload) for seq in range(40) for publish in ask(seq)}
    assert len(first) == 40 * 101
    again = [publish for seq in range(40) for publish in ask(seq)]
    assert STATION_AT_ONCE <= len(again) < STATION_AT_ONCE + 101
    bench.command(seq=1)
    assert len(words(bench.command(seq=1))) == 1, "another station has a share of its own"
    for _ in range(10):
        said = answers(bench.until(bench.now_ms + 1000))
        assert len(said) < STATION_PER_S + 2 * 101
        again += said
    assert {(publish.topic, publish.payload) for publish in again} == first


def test_what_came_within_the_second_is_answered_when_it_is_over() -> None:
    repetitions = Repetitions()
    assert [repetitions.may_answer(ONE, at_ms) for at_ms in (0, 1, PAUSE_MS - 1)] == [True, False, False]
    assert repetitions.may_answer(TWO, 1)
    assert repetitions.due(PAUSE_MS - 1) == []
    assert repetitions.due(PAUSE_MS) == [ONE]
    assert not repetitions.may_answer(ONE, PAUSE_MS + 1)
    assert repetitions.due(2 * PAUSE_MS) == [ONE]
    assert repetitions.due(3 * PAUSE_MS) == []
    assert repetitions.may_answer(ONE, 3 * PAUSE_MS)


EVE = 0xEEE
"""A station with valid credentials that floods; the others' session is GS_SESSION."""


def two_stations() -> ActivatorBench:
    """Station alpha controls drone 2, eve drone 1."""
    bench = ActivatorBench(drones=(1, 2))
    bench.appear(1)
    bench.appear(2, UAV_SESSION + 2)
    bench.register(name="eve", session=EVE, drones=(1,), lease_s=3600)
    bench.register(drones=(2,), lease_s=3600)
    return bench


def forwarded(effects: list[Any], drone: int) -> int:
    return len(of(effects, f"drone{drone}/commands"))


@pytest.mark.long
def test_a_station_in_control_cannot_fill_its_fogs_ledger_for_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command_relay, "FOG_CAPACITY", CAPACITY)
    bench, seq = two_stations(), 0
    for _ in range(30):
        bench.now_ms += 1000
        for command in (Arm(), Land()):
            for _ in range(300):
                bench.command(command, gs_session=EVE, seq=(seq := seq + 1), deadline_ms=bench.now_ms + 5000)
    full = bench.command(gs_session=EVE, seq=seq + 1)
    assert words(full) == [(Word.DENIED, "ledger_full")]
    for seq, command in enumerate((Arm(), Hold(), Land(), Return())):
        out = bench.command(command, to="drone2/commands", seq=seq, deadline_ms=bench.now_ms + 5000)
        assert forwarded(out, 2) == 1
    assert forwarded(bench.command(Land(), to="commands", seq=9, deadline_ms=bench.now_ms + 5000), 2) == 1


def test_a_station_is_given_a_share_of_the_loop_and_hold_land_and_return_one_of_their_own() -> None:
    bench = two_stations()
    out = [effect for seq in range(5000) for effect in bench.command(gs_session=EVE, seq=seq)]
    assert forwarded(out, 1) == STATION_AT_ONCE
    assert {effect.kind for effect in out if isinstance(effect, Log)} == {"flood"}
    assert forwarded(bench.command(Hold(), gs_session=EVE, seq=6000), 1) == 1
    assert forwarded(bench.command(to="drone2/commands"), 2) == 1
    bench.now_ms += 1000
    out = [effect for seq in range(7000, 9000) for effect in bench.command(gs_session=EVE, seq=seq)]
    assert abs(forwarded(out, 1) - STATION_PER_S) <= 1


def test_a_drone_takes_a_share_of_commands_from_each_station() -> None:
    uav = UavClient(1, UAV_SESSION, Settings())
    ready(uav, 1000)
    heard = [
        effect
        for seq in range(2000)
        for effect in uav.on_message(
            "fog", Inbound("drone1/commands", encode(command_payload(Arm(), gs_session=EVE, seq=seq)), 1), 1000
        )
    ]
    assert len([effect for effect in heard if isinstance(effect, Journal)]) == STATION_AT_ONCE
    other = encode(command_payload(Arm(), seq=1))
    assert any(isinstance(e, Journal) for e in uav.on_message("fog", Inbound("drone1/commands", other, 1), 1000))


def test_malformed_commands_are_denied_no_oftener_than_others() -> None:
    bench = two_stations()
    rows = (cbor2.dumps([1, EVE, seq, FOG_SESSION, 5000, 0, 0, 1]) for seq in range(5000))  # a limit of 0 s
    said = [word for row in rows for word, _ in words(bench.cloud("drone1/commands", row))]
    assert said == [Word.DENIED] * STATION_AT_ONCE


def test_who_registers_again_and_again_makes_its_fog_speak_once_a_second() -> None:
    bench = two_stations()
    bench.state()
    states = 0
    for turn in range(200):
        bench.now_ms += 20
        out = bench.register(name="eve", session=EVE + 1 + turn % 2, lease_s=30 * (turn % 4 < 2))
        states += len(of([*out, *bench.until(bench.now_ms + 1)], "fog1/drone1/state/battery"))
    assert states <= 2 + 200 * 120 // 1000


def test_however_many_stations_register_a_drone_is_asked_for_a_beacon_once_a_second() -> None:
    """All do at once where their fog was away, and a lease for each would be in front of a hold."""
    world = World(signed=True).start(3000)
    leases = 0
    for number in range(10):
        registration = Registration(
            name=f"h{number}",
            session=EVE + number,
            nonce=number,
            lease_s=30,
            until_ms=world.now_ms + 30_000,
            activator_session=FOG_SESSION,
            counter=1,
        )
        signed = seal(f"gs-h{number}").sign("fog1/init_connect", encode(registration), with_certificate=True)
        out = world.hears("activator", "fog1/init_connect", signed.encode())
        assert of(out, "fog1/clock")
        leases += len(of(out, "drone1/init_connect"))
    assert leases == 1
    world.now_ms += 1000
    assert len(of(list(world.activator.tick(world.now_ms)), "drone1/init_connect")) == 1, "for those that came later"


def test_births_are_not_even_verified_beyond_their_share(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(signed=True).start()
    birth = next(sent for name, sent in world.sent if name == "gs" and sent.topic == "gs/g/reachable")
    opened, verify = [], Seal.open
    monkeypatch.setattr(Seal, "open", lambda *given: opened.append(given) or verify(*given))
    for _ in range(5000):
        world.activator.on_message("cloud", Inbound(birth.topic, birth.payload, 1, True), world.now_ms)
    assert len(opened) <= BIRTHS_AT_ONCE


def test_a_drone_that_floods_is_given_a_share_and_the_others_are_heard() -> None:
    bench = two_stations()
    bench.command(to="drone2/commands")
    relayed = [effect for n in range(10_000) for effect in bench.state(n % 100)]
    assert {effect.kind for effect in relayed if isinstance(effect, Log)} == {"flood"}
    said = bench.fog(
        "drone2/commands_result/arm",
        ResultMessage(gs_session=GS_SESSION, seq=1, session=UAV_SESSION + 2, stamp=0, word=Word.COMPLETED),
    )
    assert words(said, 2) == [(Word.COMPLETED, None)]
    assert words(bench.result(Word.ACCEPTED, gs_session=EVE, seq=1)) == [(Word.ACCEPTED, None)], "nor its own words"


def test_what_a_station_says_of_readings_costs_it_no_control() -> None:
    """A fleet with many sensors has it say more of them in a second than an activator takes."""
    world = World(signed=True).start(1000)
    ack = seal("gs-g").sign("drone1/sensor_ack", encode(ReadingAck(readings=(reading(1).key,)))).encode()
    heard = [log for _ in range(2 * STATION_AT_ONCE) for log in world.hears("activator", "fog1/drone1/sensor_ack", ack)]
    assert {effect.kind for effect in heard} == {"flood"}
    renewal = world.gs.fogs[1].registration(world.now_ms)
    assert of(world.hears("activator", renewal.topic, renewal.payload), "fog1/clock")


def test_a_drone_that_is_born_again_and_again_makes_its_fog_speak_a_share() -> None:
    bench = two_stations()
    leases = 0
    for _ in range(1000):
        leases += len(of(bench.fog("drone1/reachable", Presence(session=UAV_SESSION, up=True)), "drone1/init_connect"))
    assert leases <= PRESENCE_AT_ONCE
    bench.now_ms += 60_000
    bench.echo(drone=2, session=UAV_SESSION + 2)
    assert bench.role.drones.links[2].is_live(bench.now_ms, 10_000)


def test_a_sensor_that_floods_is_given_a_share_and_the_others_are_stored() -> None:
    carrier = Carrier(1, Channel("fog", "", Settings()), FogSide())
    payload = encode(ReadingMessage(boot=1, seq=1, time_ms=1, value=1.0))
    flood = [
        e for n in range(5000) for e in carrier.on_message(Inbound("sensor6/temperature", payload, 1, False, (1, n)), 0)
    ]
    assert len([effect for effect in flood if isinstance(effect, StoreReading)]) == SENSOR_AT_ONCE
    assert len([effect for effect in flood if isinstance(effect, Acknowledge)]) == 5000 - SENSOR_AT_ONCE
    (stored,) = carrier.on_message(Inbound("sensor7/temperature", payload, 1, False, (1, 6000)), 0)
    assert isinstance(stored, StoreReading)


def test_a_budget_knows_no_more_stations_than_are_active() -> None:
    budget = TokenBucket(10, 20)
    assert all(budget.takes(session, session) for session in range(100_000))
    assert len(budget._paid_until_ms) <= MOST_KNOWN


def test_a_list_is_said_again_once_a_second() -> None:
    bench = two_stations()
    goto = Goto(latitude_deg=47.0, longitude_deg=8.0, altitude_m=10.0)
    deadline_ms = bench.now_ms + 5000
    first = of(bench.select(goto, deadline_ms=deadline_ms), "fog1/PSMI")
    lists = []
    for _ in range(200):
        bench.now_ms += 10
        lists += of([*bench.select(goto, deadline_ms=deadline_ms), *bench.role.relay.tick(bench.now_ms)], "fog1/PSMI")
    assert set(lists) == set(first)
    assert len(lists) in (2, 3)
