"""Presence is answered at registration, whatever the cloud broker shows of what it retains (R6.13, R9.6)."""

from __future__ import annotations

from itertools import product

import pytest

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.activator.role import Activator
from mqttxt.core.effects import Publish, Stop, Subscribe
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm
from mqttxt.protocol.control import Registration
from mqttxt.protocol.messages import BeaconMessage, FogPresence, Word
from mqttxt.protocol.topics import CloudSide
from mqttxt.station.outcomes import Outcome
from tests.simulation.fogs import ActivatorBench, of
from tests.simulation.signing import seal
from tests.simulation.world import FOG_SESSION, UAV_SESSION, World, ack, heartbeat

SHOWS = ("all", "named", "nothing")
SECOND = 0x44
ALIKE = pytest.mark.parametrize(("shows", "signed"), list(product(SHOWS, (False, True))))


def asked(world: World) -> list[Publish]:
    return [publish for name, publish in world.sent if name == "gs" and publish.topic == "fog1/init_connect"]


def is_executed(world: World) -> bool:
    """Whether a command is written to the autopilot, and the drone's word comes back."""
    wrote = len(world.wrote)
    sent = world.send(Arm())
    world.pass_time(300)
    world.autopilot(ack(400))
    words = [event.word for event in world.heard if isinstance(event, Outcome) and event.id == sent]
    return len(world.wrote) > wrote and words == [Word.ACCEPTED]


@ALIKE
def test_a_station_that_comes_last_learns_who_is_reachable_and_commands(shows: str, signed: bool) -> None:
    world = World(shows=shows, signed=signed).start(4000)
    fog = world.gs.fogs[1]
    assert fog.drones[1].reachable
    assert fog.controls(1)
    assert is_executed(world)


@ALIKE
def test_a_station_that_was_cut_off_learns_that_the_drone_has_gone_meanwhile(shows: str, signed: bool) -> None:
    world = World(shows=shows, signed=signed).start(4000)
    world.deafen("gs")
    world.run("gs", world.gs.on_disconnected(CLOUD, world.now_ms))
    world.kill("uav", FOG)
    world.run("gs", world.gs.on_connected(CLOUD, world.now_ms))
    world.pass_time(4000)
    record = world.gs.fogs[1].drones[1].record
    assert record is not None
    assert not record.up
    assert not world.gs.fogs[1].drones[1].reachable


@ALIKE
def test_activator_and_drone_that_start_anew_are_commanded_again(shows: str, signed: bool) -> None:
    """Where messages are signed the new ones have to be told the station's certificate."""
    world = World(shows=shows, signed=signed).start(4000)
    world.restart_uav(UAV_SESSION + 1, [])
    world.restart_activator(FOG_SESSION + 1)
    world.pass_time(8000)
    assert world.gs.fogs[1].session == FOG_SESSION + 1
    assert world.gs.fogs[1].drones[1].reachable
    assert is_executed(world)


@pytest.mark.parametrize("signed", [False, True])
def test_an_old_birth_that_a_node_shows_is_put_right(signed: bool) -> None:
    """A node of a cluster may retain what an activator said there that is long gone."""
    world = World(shows="named", signed=signed)
    old = encode(FogPresence(session=0x99, up=True))
    payload = seal("fog1").sign("fog1/reachable", old, with_certificate=True).encode() if signed else old
    world.start()
    world.gs.fogs.clear()
    world.deafen("gs")
    world.retained[CLOUD, "fog1/reachable"] = Publish(CLOUD, "fog1/reachable", payload, 1, retain=True)
    world.run("gs", world.gs.add_fogs([1]))
    world.pass_time(4000)
    assert world.gs.fogs[1].session == FOG_SESSION
    assert world.gs.fogs[1].drones[1].reachable


def test_what_the_broker_shows_makes_no_question_necessary() -> None:
    world = World().start()
    first = decode(Registration, asked(world)[0].payload)
    assert (first.anew, first.activator_session) == (True, FOG_SESSION)
    world.pass_time(12_000)
    assert [decode(Registration, publish.payload).anew for publish in asked(world)] == [True, None]


def test_an_activator_that_is_not_there_is_asked_for_ever_more_rarely() -> None:
    world = World()
    world.uav.on_mavlink(heartbeat(), 0)
    world.gs.add_fogs([1])
    world.run("gs", world.gs.on_connected(CLOUD, 0))
    at_ms: list[int] = []
    while world.now_ms < 60_000:
        before = len(asked(world))
        world.pass_time(100)
        at_ms += [world.now_ms] * (len(asked(world)) - before)
    assert at_ms == [1000, 3000, 7000, 15_000, 31_000, 47_000]
    question = decode(Registration, asked(world)[0].payload)
    assert (question.lease_s, question.activator_session, question.anew) == (0, None, True)


def test_a_station_is_ready_once_it_knows_who_controls_the_drones() -> None:
    """A command names the newest epoch of control: one that is sent before that is known would be denied."""
    world = World().start()
    fog = world.gs.fogs[1]
    world.drop = {"reachable"}
    fog.drones.clear()
    fog.registered = False
    world.run("gs", [fog.registration(0)])
    assert fog.registered
    assert not world.gs.fogs[1].is_ready(world.now_ms)
    world.pass_time(2000)
    assert world.gs.fogs[1].is_ready(world.now_ms)


def test_records_come_before_the_beacon_that_confirms_and_states_behind_it() -> None:
    bench = ActivatorBench(drones=(1, 2))
    bench.appear()
    bench.state()
    out = [effect.topic for effect in bench.register(anew=True, activator_session=FOG_SESSION)]
    told = [topic for topic in out if topic.startswith("fog1/")]
    assert told.index("fog1/drone2/reachable") < told.index("fog1/clock") < told.index("fog1/drone1/state/battery")
    assert "fog1/reachable" not in told


def test_a_renewal_is_told_nothing_that_it_was_told() -> None:
    bench = ActivatorBench()
    bench.register(anew=True, activator_session=FOG_SESSION)
    assert [effect.topic for effect in bench.register()] == ["fog1/clock"]


def test_who_names_another_session_is_told_the_birth_and_is_not_registered() -> None:
    for named in (None, 99):
        bench = ActivatorBench()
        out = bench.register(anew=True, activator_session=named)
        (birth,) = of(out, "fog1/reachable")
        assert decode(FogPresence, birth.payload).session == FOG_SESSION
        assert len(out) == 1
        assert not bench.role.leases


def test_questions_without_end_are_answered_once_a_second() -> None:
    bench = ActivatorBench()
    out = [effect for _ in range(50) for effect in bench.register(anew=True)]
    assert len(of(out, "fog1/reachable")) == 1
    assert len(of(bench.until(bench.now_ms + 3000), "fog1/reachable")) == 1


# Two activators of one fog, of which the broker has shown the second nothing


def second_activator(world: World) -> None:
    world.second = Activator(1, SECOND, world.settings, drones=(1,), seal=world._seal("fog1"))  # type: ignore[attr-defined]
    world.run("second", world.second.on_connected(CLOUD, 0))  # type: ignore[attr-defined]


@pytest.mark.parametrize("signed", [False, True])
def test_the_second_activator_stops_though_the_broker_did_not_show_the_first(signed: bool) -> None:
    world = World(shows="nothing", signed=signed).start(4000)
    second_activator(world)
    assert world.second.born  # type: ignore[attr-defined]
    world.pass_time(1500)
    assert {stop.reason for stop in world.stops} == {"refused: another live activator is fog 1 already"}
    world.deafen("second")
    world.run("second", world.second.goodbye(5000))  # type: ignore[attr-defined]
    world.pass_time(4000)
    assert world.gs.fogs[1].session == FOG_SESSION
    assert world.gs.fogs[1].drones[1].reachable


def test_a_first_activator_does_not_make_room_for_a_second_one_that_answers() -> None:
    """Long after its birth it puts its topic right, and asks nobody; soon after it, it goes on before a younger one."""
    for age_ms in (1000, 10_000):
        bench = ActivatorBench()
        bench.until(bench.now_ms + age_ms)
        out = bench.cloud("reachable", FogPresence(session=99, up=True))
        for subscribe in [effect for effect in out if isinstance(effect, Subscribe)]:
            out += bench.role.on_subscribed(subscribe, bench.now_ms)
        assert bool(of(out, "fog1/init_connect")) == (age_ms == 1000)
        out += bench.cloud("clock", BeaconMessage(session=99, now_ms=bench.now_ms - 1, nonce=1, held_ms=0))
        assert not any(isinstance(effect, Stop) for effect in out)
        assert len(of(bench.until(bench.now_ms + 4000), "fog1/reachable")) == 1


@pytest.mark.parametrize(
    ("session", "asks", "stops"),
    [(FOG_SESSION - 1, True, False), (FOG_SESSION + 1, True, True), (FOG_SESSION - 1, False, True)],
)
def test_of_two_that_both_go_on_one_stops(session: int, asks: bool, stops: bool) -> None:
    """They were started at one moment, so that neither finds itself the younger one; or the other is not new."""
    bench = ActivatorBench()
    out = bench.cloud("reachable", FogPresence(session=session, up=True))
    for subscribe in [effect for effect in out if isinstance(effect, Subscribe)]:
        out += bench.role.on_subscribed(subscribe, bench.now_ms)
    if asks:
        bench.cloud("init_connect", Registration(name="activator", session=session, nonce=2, lease_s=0))
    for is_last in (False, True):
        (question,) = of(out, "fog1/init_connect")
        nonce = decode(Registration, question.payload).nonce
        own = BeaconMessage(session=session, now_ms=bench.now_ms - 1, nonce=nonce, held_ms=0)
        heard = bench.cloud("clock", own)
        assert any(isinstance(effect, Stop) for effect in heard) == (is_last and stops)
        out = bench.until(bench.now_ms + 3000)
    assert of(out, "fog1/init_connect") == []


def test_who_comes_back_to_a_broker_that_does_not_show_its_successor_stops() -> None:
    world = World(shows="nothing").start(4000)
    world.subscribed = [entry for entry in world.subscribed if entry[:2] != ("activator", CLOUD)]
    world.run("activator", world.activator.on_disconnected(CLOUD, world.now_ms))
    second_activator(world)
    world.pass_time(4000)
    world.run("activator", world.activator.on_connected(CLOUD, world.now_ms))
    assert world.activator.born
    assert world.second.born  # type: ignore[attr-defined]
    world.pass_time(1000)
    world.run("second", world.second.tick(world.now_ms))  # type: ignore[attr-defined]
    assert {stop.reason for stop in world.stops} == {"refused: another live activator is fog 1 already"}


def test_an_old_birth_of_a_session_that_does_not_answer_changes_nothing() -> None:
    bench = ActivatorBench()
    out = bench.cloud("reachable", FogPresence(session=99, up=True))
    (subscribe,) = [effect for effect in out if isinstance(effect, Subscribe)]
    assert subscribe.filters == (CloudSide(1).clock,)
    bench.role.on_subscribed(subscribe, bench.now_ms)
    assert not any(isinstance(effect, Stop) for effect in bench.until(bench.now_ms + 4000))
    assert bench.role.born


# Where messages are signed


def test_a_question_for_another_session_is_answered_where_messages_are_signed() -> None:
    world = World(signed=True).start()
    fields = {"name": "h", "session": 0x88, "nonce": 1, "lease_s": 0, "counter": 1, "anew": True}
    for named in (None, 0x99):
        message = encode(Registration(**fields, activator_session=named))  # type: ignore[arg-type]
        payload = seal("gs-h").sign("fog1/init_connect", message, with_certificate=True).encode()
        world.now_ms += 1000
        out = world.hears("activator", "fog1/init_connect", payload)
        assert [effect.topic for effect in out if isinstance(effect, Publish)] == ["fog1/reachable"]
    assert ("h", 0x88) not in world.activator.leases
