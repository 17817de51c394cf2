"""The activator: gate, presence, identity and the stamps of states (sections 4, 6 and 9)."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.activator.stations import MOST_STATIONS
from mqttxt.core.effects import Inbound, Log, Publish, Stop, Subscribe, Unsubscribe
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.control import Control, DroneLease, DroneRecord
from mqttxt.protocol.messages import BeaconMessage, FogPresence, Presence, Word
from mqttxt.protocol.state_payload import decode_state
from mqttxt.protocol.states import Armed
from tests.simulation.fogs import BORN_MS, UAV_AHEAD_MS, ActivatorBench, of, ready, words
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION, World, heartbeat


def record(effects: list[Any]) -> DroneRecord:
    """The one record of drone 1 among these effects."""
    (told,) = of(effects, "fog1/drone1/reachable")
    return decode(DroneRecord, told.payload)


# Birth and rivals


def test_commands_are_subscribed_live_only_and_birth_waits_for_what_is_retained() -> None:
    bench = ActivatorBench(born=False)
    assert [s.live_only for s in bench.subscribes] == [True, False, False]
    assert not bench.role.born
    assert len(of(bench.beacons, "fog1/clock")) == 1
    birth = bench.be_shown()
    assert Unsubscribe("cloud", ("fog1/clock", "fog1/drone1/reachable")) in birth
    (presence,) = of(birth, "fog1/reachable")
    assert presence.retain
    told = decode(FogPresence, presence.payload)
    assert (told.session, told.up, told.authenticated) == (FOG_SESSION, True, False)
    assert [entry.drone for entry in told.drones or ()] == [1]
    assert record(birth) == DroneRecord(activator_session=FOG_SESSION, up=False)


def test_a_live_rival_makes_the_second_activator_stop() -> None:
    bench = ActivatorBench(born=False)
    bench.cloud("reachable", FogPresence(session=99, up=True), retain=True)
    question = bench.cloud("clock", BeaconMessage(session=FOG_SESSION, now_ms=BORN_MS))
    assert len(of(question, "fog1/init_connect")) == 1
    (stop,) = bench.cloud("clock", BeaconMessage(session=99, now_ms=5))
    assert isinstance(stop, Stop)


def test_a_rival_that_does_not_answer_is_replaced() -> None:
    bench = ActivatorBench(born=False)
    bench.cloud("reachable", FogPresence(session=99, up=True), retain=True)
    bench.cloud("clock", BeaconMessage(session=FOG_SESSION, now_ms=BORN_MS))
    assert bench.until(BORN_MS + 2900) == []
    (named,) = bench.until(BORN_MS + 3000)
    assert isinstance(named, Subscribe)
    bench.role.on_subscribed(named, bench.now_ms)
    assert len(of(bench.be_shown(), "fog1/reachable")) == 1


def test_before_its_first_birth_an_activator_hands_down_no_lease() -> None:
    """It may be a second one, started by mistake: its lease would end an offboard flight under the first."""
    bench = ActivatorBench(born=False)
    met = bench.fog("drone1/reachable", Presence(session=UAV_SESSION, up=True))
    assert of([*met, *bench.until(bench.now_ms + 500)], "drone1/init_connect") == []
    bench.be_shown()
    (lease,) = of(bench.until(bench.now_ms + 500), "drone1/init_connect")
    assert decode(DroneLease, lease.payload).drone_session == UAV_SESSION


@pytest.mark.parametrize("answers", [True, False])
def test_a_drones_second_session_that_comes_before_the_first_birth_is_judged_after_it(answers: bool) -> None:
    """The one before may have died without a will: the newcomer must not wait for the broker to notice that."""
    bench = ActivatorBench(born=False)
    bench.fog("drone1/reachable", Presence(session=UAV_SESSION, up=True))
    bench.echo()
    bench.fog("drone1/reachable", Presence(session=77, up=True))
    assert of(bench.until(bench.now_ms + 2000), "drone1/init_connect") == []
    bench.be_shown()
    (asked,) = of(bench.until(bench.now_ms + 100), "drone1/init_connect")
    out = bench.echo(decode(DroneLease, asked.payload).nonce) if answers else []
    leases = of([*out, *bench.until(bench.now_ms + 1500)], "drone1/init_connect")
    said = [(lease.drone_session, lease.bound) for lease in (decode(DroneLease, one.payload) for one in leases)]
    assert said == [(77, not answers)]


def test_before_its_birth_an_activator_answers_nobody() -> None:
    bench = ActivatorBench(born=False)
    assert [type(e) for e in bench.command()] == [Log]
    assert [type(e) for e in bench.register()] == [Log]
    assert not bench.role.leases


@pytest.mark.parametrize("seen", [FogPresence(session=99, up=False), FogPresence(session=FOG_SESSION, up=False)])
def test_a_late_will_is_answered_with_a_new_birth(seen: FogPresence) -> None:
    bench = ActivatorBench()
    bench.cloud("reachable", seen, retain=True)
    (presence,) = of(bench.until(BORN_MS + 1100), "fog1/reachable")
    assert decode(FogPresence, presence.payload).session == FOG_SESSION


def test_another_sessions_word_about_a_drone_is_put_right() -> None:
    bench = ActivatorBench()
    bench.until(BORN_MS)
    bench.cloud("drone1/reachable", DroneRecord(activator_session=99, up=True, drone_session=5), True)
    assert record(bench.until(BORN_MS + 1100)) == DroneRecord(activator_session=FOG_SESSION, up=False)


def test_a_clean_stop_says_so_for_the_fog_and_its_drones() -> None:
    effects = ready().role.goodbye(BORN_MS)
    assert [e.topic for e in effects if isinstance(e, Publish)] == ["fog1/drone1/reachable", "fog1/reachable"]
    assert effects[-1] == Publish("cloud", "fog1/reachable", ActivatorBench().role.will().payload, 1, True)


# Presence and identity of drones


def test_a_drone_is_reachable_after_its_echo_and_not_before() -> None:
    bench = ActivatorBench()
    assert of(bench.fog("drone1/reachable", Presence(session=UAV_SESSION, up=True)), "fog1/drone1/reachable") == []
    told = record(bench.appear())
    assert (told.up, told.drone_session, told.activator_session) == (True, UAV_SESSION, FOG_SESSION)


def test_a_drones_will_or_silence_makes_it_unreachable() -> None:
    assert not record(ready().fog("drone1/reachable", Presence(session=UAV_SESSION, up=False))).up
    bench = ready(controlled=False)
    assert of(bench.until(BORN_MS + 30_000), "fog1/drone1/reachable") == []
    assert not record(bench.until(BORN_MS + 30_100)).up


def test_an_old_sessions_will_changes_nothing() -> None:
    assert of(ready().fog("drone1/reachable", Presence(session=77, up=False)), "fog1/drone1/reachable") == []


def test_a_second_live_session_is_refused_and_the_first_stays_bound() -> None:
    bench = ready()
    (log, lease) = bench.fog("drone1/reachable", Presence(session=77, up=True))
    assert log.kind == "contested"
    question = decode(DroneLease, lease.payload)
    assert question.drone_session == UAV_SESSION
    (refusal,) = bench.echo(question.nonce)
    answer = decode(DroneLease, refusal.payload)
    assert (answer.drone_session, answer.bound) == (77, False)


def old_nonce(bench: ActivatorBench) -> int:
    """The nonce of a lease that the drone has not echoed, a second later."""
    leases = of(bench.until(bench.now_ms + 10_100), "drone1/init_connect")
    bench.now_ms += 1000
    return decode(DroneLease, leases[-1].payload).nonce


def test_an_answer_to_an_earlier_lease_does_not_show_that_the_first_session_is_there() -> None:
    """It may have stood in a connection (R9.5)."""
    bench = ready()
    nonce = old_nonce(bench)
    bench.fog("drone1/reachable", Presence(session=77, up=True))
    assert of(bench.echo(nonce), "drone1/init_connect") == []
    assert bench.until(bench.now_ms + 1600)
    assert bench.role.drones.links[1].session == 77


@pytest.mark.parametrize("is_old", [True, False])
def test_a_will_of_several_is_the_end_unless_a_lease_behind_it_is_answered(is_old: bool) -> None:
    bench = ready()
    nonce = old_nonce(bench)
    will = Presence(session=UAV_SESSION, up=False, several=True)
    (asked,) = of(bench.fog("drone1/reachable", will), "drone1/init_connect")
    bench.echo(nonce if is_old else decode(DroneLease, asked.payload).nonce)
    bench.until(bench.now_ms + 1600)
    assert bench.role.drones.links[1].announced is not is_old


def test_a_first_session_that_does_not_answer_is_replaced() -> None:
    bench = ready()
    bench.fog("drone1/reachable", Presence(session=77, up=True))
    leases = of(bench.until(BORN_MS + 1500), "drone1/init_connect")
    assert [decode(DroneLease, e.payload).drone_session for e in leases] == [77]


def test_a_second_session_that_is_gone_again_is_not_bound() -> None:
    """The first one's answer may take longer than the contest."""
    bench = ready()
    for up in (True, False):
        bench.fog("drone1/reachable", Presence(session=77, up=up))
    assert of(bench.until(BORN_MS + 2000), "drone1/init_connect") == []
    assert bench.role.drones.links[1].session == UAV_SESSION


def test_a_restarted_drone_is_not_refused_by_its_own_echo() -> None:
    """Born while the old session seemed alive; then the old will comes, and the new session is born again."""
    bench = ready()
    bench.fog("drone1/reachable", Presence(session=77, up=True))
    bench.fog("drone1/reachable", Presence(session=UAV_SESSION, up=False))
    effects = bench.appear(session=77)
    assert all(decode(DroneLease, e.payload).bound for e in of(effects, "drone1/init_connect"))
    assert len(of(effects, "fog1/drone1/reachable")) == 1
    assert of(bench.until(BORN_MS + 3000), "fog1/drone1/reachable") == []


def test_what_a_stranger_shows_of_a_drone_is_put_right_though_the_right_record_is_shown_meanwhile() -> None:
    bench = ready()
    right = decode(DroneRecord, bench.role.drones.record_of(1).payload)  # type: ignore[union-attr]
    wrong = DroneRecord(activator_session=FOG_SESSION, up=False)
    for shown in (wrong, right, wrong, right):
        assert of(bench.until(bench.now_ms + 200), "fog1/drone1/reachable") == []
        bench.cloud("drone1/reachable", shown)
    assert record(bench.until(bench.now_ms + 500)) == right
    assert of(bench.until(bench.now_ms + 2000), "fog1/drone1/reachable") == []


def test_without_the_fog_broker_no_drone_is_reachable() -> None:
    bench = ready()
    assert not record(bench.role.on_disconnected("fog", bench.now_ms)).up
    assert words(bench.command()) == [(Word.UNREACHABLE, None)]


# Gate and stamps


def test_the_gate_lets_states_through_only_while_a_lease_lives() -> None:
    bench = ready(controlled=False)
    assert bench.state(50) == []
    assert len(of(bench.register(), "fog1/drone1/state/battery")) == 1
    bench.until(BORN_MS + 100)
    assert len(of(bench.state(49), "fog1/drone1/state/battery")) == 1
    bench.until(BORN_MS + 30_200)
    assert bench.state(48) == []


def test_leases_are_of_a_station_and_a_session() -> None:
    bench = ready()
    bench.register()
    bench.register(session=5)
    bench.role.on_message("cloud", Inbound("gs/alpha/reachable", encode(Presence(session=5, up=False))), 0)
    assert ("alpha", GS_SESSION) in bench.role.leases
    assert ("alpha", 5) not in bench.role.leases


def test_a_registration_is_echoed_by_a_beacon() -> None:
    (beacon,) = of(ActivatorBench().register(), "fog1/clock")
    assert decode(BeaconMessage, beacon.payload) == BeaconMessage(
        session=FOG_SESSION, now_ms=BORN_MS, nonce=7, held_ms=0
    )


def test_the_gate_never_stops_results() -> None:
    bench = ready()
    bench.command()
    assert words(bench.result(Word.ACCEPTED)) == [(Word.ACCEPTED, None)]


def test_a_relayed_state_keeps_its_stamp_behind_a_conservative_one() -> None:
    bench = ready()
    bench.register()
    bench.until(BORN_MS + 3000)
    (publish,) = bench.state(40, stamped_ms=BORN_MS + 1000)
    relayed = decode_state("battery", publish.payload, relayed=True)
    assert relayed.stamp == (BORN_MS + 1000 + UAV_AHEAD_MS) // 10
    assert BORN_MS + 900 <= relayed.relay_stamp * 10 <= BORN_MS + 1000  # type: ignore[operator]


def test_an_older_state_does_not_replace_a_newer_one() -> None:
    bench = ready()
    bench.register()
    bench.until(BORN_MS + 1000)
    bench.state(40)
    assert bench.state(41, stamped_ms=BORN_MS) == []


def test_a_later_echo_never_makes_an_earlier_state_look_old_or_of_the_future() -> None:
    bench = ready()
    bench.state(50)
    for step in range(1, 5):  # the drone's clock falls behind by a millisecond a second
        leases = of(bench.until(BORN_MS + step * 10_000), "drone1/init_connect")
        lease = decode(DroneLease, leases[-1].payload)
        slower = BeaconMessage(
            session=UAV_SESSION,
            now_ms=bench.now_ms + UAV_AHEAD_MS - bench.now_ms // 1000 + BORN_MS // 1000,
            nonce=lease.nonce,
            held_ms=0,
        )
        bench.fog("drone1/clock", slower)
        age_ms = bench.role.drones.links[1].age_ms("battery", bench.now_ms)
        assert age_ms is not None
        assert bench.now_ms - BORN_MS - 40 <= age_ms <= bench.now_ms - BORN_MS + 11_000


def test_more_stations_than_an_activator_remembers_are_not_registered() -> None:
    bench = ready()
    for session in range(1, MOST_STATIONS + 50):
        bench.register(name="many", session=1000 + session, control=Control.NONE)
    assert len(bench.role.leases) == MOST_STATIONS
    assert [type(effect) for effect in bench.register(name="late", session=5)] == [Log]
    assert of(bench.register(), "fog1/clock") != []


def test_a_forged_will_again_and_again_does_not_put_the_birth_off() -> None:
    bench, births = ActivatorBench(), 0
    for _ in range(12):
        bench.cloud("reachable", FogPresence(session=FOG_SESSION, up=False), retain=True)
        births += len(of(bench.until(bench.now_ms + 800), "fog1/reachable"))
    assert 5 <= births <= 10


@pytest.mark.parametrize("lost_lease", [False, True])
@pytest.mark.parametrize("signed", [False, True])
def test_what_drones_said_while_the_connection_to_the_fog_was_lost_comes_when_it_is_back(
    signed: bool, lost_lease: bool
) -> None:
    """The drone's own connection stays, so that it does not know by itself that nobody has heard it."""
    world = World(signed=signed).start()
    world.pass_time(2000)
    lost = [entry for entry in world.subscribed if entry[:2] == ("activator", "fog")]
    world.subscribed = [entry for entry in world.subscribed if entry not in lost]
    world.run("activator", world.activator.on_disconnected("fog", world.now_ms))
    world.autopilot(heartbeat(armed=True))
    world.pass_time(500)
    world.drop = {"init_connect"} if lost_lease else set()
    world.run("activator", world.activator.on_connected("fog", world.now_ms))
    world.pass_time(100)
    world.drop = set()
    world.pass_time(11_000 if lost_lease else 1000)
    assert world.gs.fogs[1].drones[1].states["armed"].message.state == Armed(True)
    told = len(world.sent)
    world.pass_time(15_000)
    again = [publish.topic for sender, publish in world.sent[told:] if sender == "uav" and "/state/" in publish.topic]
    assert "drone1/state/armed" not in again


@pytest.mark.parametrize("signed", [False, True])
def test_a_starting_activator_says_nothing_of_a_drone_before_it_has_read_what_is_retained(signed: bool) -> None:
    """Its record would replace the one that says who controls the drone, or that of an activator that is live."""
    world = World(signed=signed).start()
    world.pass_time(2000)
    sent = len(world.sent)
    world.restart_activator(FOG_SESSION + 1)
    told = [publish.topic for name, publish in world.sent[sent:] if name == "activator"]
    assert told.index("fog1/reachable") < told.index("fog1/drone1/reachable")
