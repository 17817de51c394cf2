"""Signed control (docs/protocol.md, section 12): registrations, takeovers, leases and grants."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from mqttxt.activator.role import Activator
from mqttxt.core.effects import Inbound, Publish, Stop, Subscribe
from mqttxt.core.hearing import ANSWER_MS, SILENT_MS
from mqttxt.core.session_owners import MOST_OF_ONE
from mqttxt.core.settings import Settings
from mqttxt.drone.grants import MOST_GRANTS, Grants
from mqttxt.protocol.bulk import BulkAsk, Get
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Hold, Offboard, Velocity
from mqttxt.protocol.control import Control, DroneLease, Grant, Registration
from mqttxt.protocol.messages import BeaconMessage, FogPresence, Presence, Word
from mqttxt.security.cose import Envelope
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from mqttxt.station.role import StationRole
from tests.simulation.signed import (
    OTHER_SESSION,
    kinds,
    last_sent,
    meet,
    said,
    signed_command,
    signed_world,
    to_drone,
)
from tests.simulation.signing import seal
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION, World, heartbeat, landed, position

# Registrations, control, leases, grants.


def registration(world: World, by: Seal, **changed: Any) -> list[Any]:
    fields: dict[str, Any] = {
        "name": by.certificate.node.label,
        "session": OTHER_SESSION,
        "nonce": 1,
        "lease_s": 30,
        "control": Control.WANT,
        "until_ms": world.now_ms + 20_000,
        "activator_session": FOG_SESSION,
        "counter": 5,
    }
    payload = by.sign("fog1/init_connect", encode(Registration(**{**fields, **changed})), with_certificate=True)
    return world.hears("activator", "fog1/init_connect", payload.encode())


@pytest.mark.parametrize(
    "changed",
    [
        {"name": "g"},
        {"session": GS_SESSION},
        {"activator_session": OTHER_SESSION},
        {"activator_session": None},
        {"counter": None},
        {"until_ms": None},
        {"until_ms": 1},
    ],
)
def test_a_registration_names_its_signer_this_session_an_end_and_a_counter(
    world: World, changed: dict[str, Any]
) -> None:
    out = registration(world, seal("gs-h"), **changed)
    assert kinds(out)[0] in ("foreign_session", "old_registration")
    assert len(world.activator.leases) == 1


def test_an_old_registration_is_not_heard_and_ends_nothing_either(world: World) -> None:
    station = seal("gs-h")
    assert kinds(registration(world, station, counter=5)) == []
    assert kinds(registration(world, station, counter=5)) == ["old_registration"]
    assert kinds(registration(world, station, counter=4, lease_s=0)) == ["old_registration"]
    assert len(world.activator.leases) == 2
    assert kinds(registration(world, station, counter=6, lease_s=0)) == []
    assert len(world.activator.leases) == 1
    assert kinds(registration(world, station, counter=5)) == ["old_registration"]
    assert len(world.activator.leases) == 1


def test_an_old_birth_of_an_activator_that_a_broker_repeats_frees_no_control(world: World) -> None:
    """The station then has no beacon of the session, and asks for one: that is no end of its lease."""
    birth = last_sent(world, "fog1/reachable")
    old = seal("fog1").sign(birth.topic, encode(FogPresence(session=OTHER_SESSION, up=True))).encode()
    for payload in (old, birth.payload):
        world.run("gs", world.hears("gs", birth.topic, payload))
        assert world.activator.leases.controls(GS_SESSION, 1)
    world.pass_time(100)
    assert world.gs.fogs[1].registered
    world.run("gs", world.gs.goodbye(world.now_ms))
    assert not world.activator.leases


def test_a_beacon_confirms_one_registration(world: World) -> None:
    beacon = last_sent(world, "fog1/clock")
    world.gs.on_disconnected("cloud", world.now_ms)
    fog = world.gs.fogs[1]
    fog.up = True
    world.hears("gs", "fog1/clock", beacon.payload)
    assert not fog.registered


def test_one_station_leaves_room_for_others(world: World) -> None:
    for session in range(1000, 1000 + MOST_OF_ONE):
        assert kinds(registration(world, seal("gs-h"), session=session)) == []
    assert kinds(registration(world, seal("gs-h"), session=2000)) == ["too_many_stations"]
    assert len(world.activator.leases) == 1 + MOST_OF_ONE
    assert kinds(registration(world, seal("gs-new"))) == []
    assert kinds(registration(world, seal("gs-h"), session=1000, counter=6)) == []


@pytest.mark.parametrize("is_record_first", [True, False])
def test_nobody_takes_the_session_that_controls_a_drone_while_its_activator_starts(
    world: World, is_record_first: bool
) -> None:
    birth = seal("gs-h").sign("gs/h/reachable", encode(Presence(session=GS_SESSION, up=True)), with_certificate=True)
    record = last_sent(world, "fog1/drone1/reachable")
    retained = [(record.topic, record.payload), ("gs/h/reachable", birth.encode())]
    started = Activator(1, 0x99, Settings(), drones=(1,), seal=seal("fog1"))
    for topic, payload in retained if is_record_first else reversed(retained):
        started.on_message("cloud", Inbound(topic, payload, 1, True), 0)
    assert started.owners.claim(GS_SESSION, "gs-g")
    assert not started.owners.claim(GS_SESSION, "gs-h")


def test_control_follows_rights(world: World) -> None:
    two = seal("gs-two", Rights(command=frozenset({2})))
    registration(world, two, drones=(1, 2))
    assert not world.activator.leases.controls(OTHER_SESSION, 1)
    registration(world, two, control=Control.TAKE, counter=6, epoch=100)
    assert world.activator.leases.controls(GS_SESSION, 1)
    lease = world.activator.leases._leases["two", OTHER_SESSION]
    assert lease.drones == frozenset({2})


def test_a_takeover_takes_a_right_and_a_registration(world: World) -> None:
    polite = seal("gs-polite", Rights(command=None))
    registration(world, polite)
    registration(world, polite, control=Control.TAKE, counter=6, epoch=100)
    assert world.activator.leases.controls(GS_SESSION, 1)
    taker = seal("gs-h")
    registration(world, taker, session=0x88, control=Control.TAKE, epoch=100)
    assert world.activator.leases.controls(GS_SESSION, 1)
    registration(world, taker, session=0x88, control=Control.TAKE, counter=6, epoch=100)
    assert world.activator.leases.controls(0x88, 1)


def test_a_takeover_is_told_to_everybody(world: World) -> None:
    taker = World(signed=True)
    taker.gs = StationRole("h", OTHER_SESSION, Settings(), seal=seal("gs-h"))
    world.deafen("gs")
    world.gs = taker.gs
    world.gs.add_fogs([1])
    world.run("gs", world.gs.on_connected("cloud", world.now_ms))
    world.pass_time(1000)
    world.run("gs", world.gs.take_over(1, None, world.now_ms))
    world.pass_time(1000)
    assert world.gs.fogs[1].controls(1)
    world.send(Arm())
    assert len(world.wrote) == 1


def test_a_will_frees_no_control(world: World) -> None:
    will = world.gs.will()
    assert world.hears("activator", will.topic, will.payload) == []
    assert world.activator.leases.controls(GS_SESSION, 1)


def lease(by: str, **changed: Any) -> Envelope:
    fields = {"activator_session": FOG_SESSION, "drone_session": UAV_SESSION, "nonce": 1, "bound": True, "counter": 999}
    fields |= changed
    return seal(by).sign("drone1/init_connect", encode(DroneLease(**fields)), with_certificate=True)


def test_a_drone_takes_leases_of_its_own_fog_alone(world: World) -> None:
    for by in ("fog2", "gs-g", "drone1"):
        out = world.hears("uav", "drone1/init_connect", lease(by, bound=False).encode())
        assert kinds(out)[0] in ("unknown_signer", "certificate", "forged"), by
    assert [type(effect) for effect in refused(world)] == [Stop]


def refused(world: World, **changed: Any) -> list[Any]:
    """What the UAV client does when its fog's key says that another one is the drone."""
    payload = lease("fog1", bound=False, **changed).encode()
    return world.hears("uav", "drone1/init_connect", payload)


def test_no_activator_stops_a_bound_client_in_flight(world: World) -> None:
    """Only on the ground, where a second client of a number is to stop."""
    world.autopilot(heartbeat(armed=True), landed(2), position(10.0))
    assert kinds(refused(world)) == ["refused_in_flight"]
    world.send(Hold())
    assert len(world.wrote) == 1
    show_presence(world, up=True)
    world.pass_time(3000)
    assert world.uav.is_controlled(world.now_ms)
    assert not [one for _, one in world.sent if one.topic == "drone1/reachable"][1:], "no contest in flight"
    world.drop = {"init_connect"}
    assert kinds(refused(world, counter=1000)) == ["refused_in_flight"]
    world.autopilot(heartbeat(armed=False), landed(1))
    assert [type(effect) for effect in world.uav.tick(world.now_ms)] == [Stop]


def show_presence(world: World, up: bool) -> None:
    """Another client's birth or its end, on the drone's topic."""
    foreign = seal("drone1").sign("drone1/reachable", encode(Presence(session=7, up=up)), with_certificate=True)
    world.hears("uav", "drone1/reachable", foreign.encode(), retain=True)


def births(world: World) -> int:
    return sum(publish.topic == "drone1/reachable" for _, publish in world.sent)


def test_a_client_that_was_refused_in_flight_is_there_again_once_the_other_is_gone(world: World) -> None:
    world.autopilot(heartbeat(armed=True), landed(2), position(10.0))
    show_presence(world, up=True)
    refused(world)
    before = births(world)
    world.pass_time(3000)
    assert births(world) == before, "what was to be put right before it was refused is left, too"
    world.drop = {"init_connect"}
    refused(world, counter=1000)
    show_presence(world, up=False)
    world.pass_time(3000)
    assert births(world) == before + 1


def test_a_client_that_was_refused_in_flight_says_nothing_into_a_silence(world: World) -> None:
    world.autopilot(heartbeat(armed=True))
    world.drop = {"init_connect"}
    refused(world)
    before = births(world)
    world.pass_time(3 * (SILENT_MS + ANSWER_MS))
    assert births(world) == before
    assert world.reconnects == []


def test_a_client_that_is_bound_again_goes_on_after_its_flight(world: World) -> None:
    world.autopilot(heartbeat(armed=True))
    refused(world, counter=20)
    world.run("activator", world.activator.drones.ask_all(world.now_ms))
    assert kinds(refused(world, counter=1)) == ["old_lease"]
    world.autopilot(heartbeat(armed=False))
    assert not any(isinstance(effect, Stop) for effect in world.uav.tick(world.now_ms))


def test_no_activator_makes_control_last_longer_than_its_station_has_granted(world: World) -> None:
    wide = lease("fog1", holder="g", holder_session=GS_SESSION, deadline_ms=2**40, offboard_until_ms=2**40)
    world.hears("uav", "drone1/init_connect", wide.encode())
    until_ms = world.uav.desk.executor.lease.until_ms
    assert until_ms is not None
    assert world.now_ms < until_ms <= world.now_ms + 30_000
    assert world.uav.desk.executor.lease.offboard_until_ms == 0
    longest = {"deadline_ms": 2**40, "offboard_until_ms": 2**40}
    nobodys = lease("fog1", counter=1000, holder="h", holder_session=OTHER_SESSION, **longest)
    world.hears("uav", "drone1/init_connect", nobodys.encode())
    assert not world.uav.is_controlled(world.now_ms)


def leases_of(world: World) -> list[Publish]:
    return [publish for _, publish in world.sent if publish.topic == "drone1/init_connect"]


def control(world: World) -> tuple[int | None, int, bool]:
    executor = world.uav.desk.executor
    return executor.lease.holder_session, world.uav.desk.holder.epoch, world.uav.is_controlled(world.now_ms)


def deliver(world: World, publish: Publish) -> None:
    world.run("uav", world.hears("uav", publish.topic, publish.payload))


def test_a_station_that_does_not_control_the_drone_is_denied_by_the_drone_itself(world: World) -> None:
    """Its fog's broker brings the command straight to the drone, past the activator."""
    meet(world, seal("gs-h"), OTHER_SESSION)
    out = to_drone(world, signed_command(seal("gs-h"), gs_session=OTHER_SESSION))
    assert said(out) == [(Word.DENIED, "not_in_control")]
    world.drop = {"init_connect"}
    world.pass_time(31_000)
    late = signed_command(seq=20, deadline_ms=world.now_ms + 3000)
    assert said(to_drone(world, late)) == [(Word.DENIED, "not_in_control")]  # its lease has lapsed


def named_first(by: Seal) -> World:
    """A fog's broker shows the drone that another station has the session of the one in control, before that one."""
    world = World(signed=True)
    world.drop = {"stations"}
    world.start()
    meet(world, by, GS_SESSION)
    world.pass_time(1000)
    return world


def forgotten(by: Seal) -> World:
    """The same, once it has shown the drone as many births of the one in control as it keeps."""
    world = signed_world()
    for session in range(1000, 1000 + MOST_OF_ONE):
        meet(world, seal("gs-g"), session)
    meet(world, by, GS_SESSION)
    return world


@pytest.mark.parametrize("made", [named_first, forgotten])
def test_a_session_is_in_control_for_the_station_alone_that_the_lease_names(made: Callable[[Seal], World]) -> None:
    other = seal("gs-h")
    world = made(other)
    assert kinds(to_drone(world, signed_command(other))) == ["foreign_session"]
    grant = other.sign(
        "drone1/control", encode(Grant(gs_session=GS_SESSION, drone_session=UAV_SESSION, until_ms=10**6))
    )
    assert kinds(world.hears("uav", "drone1/control", grant.encode())) == ["foreign_session"]
    world.drop = set()
    world.pass_time(11_000)
    world.run("uav", world.hears("uav", "drone1/stations", last_sent(world, "gs/g/reachable").payload))
    world.send(Arm())
    assert len(world.wrote) == 1


def test_a_lease_that_names_no_station_gives_nobody_control(world: World) -> None:
    nobodys = lease("fog1", holder_session=GS_SESSION, deadline_ms=2**40)
    world.hears("uav", "drone1/init_connect", nobodys.encode())
    assert said(to_drone(world, signed_command())) == [(Word.DENIED, "not_in_control")]


def test_a_station_that_is_registered_keeps_its_session_whatever_births_come(world: World) -> None:
    for session in range(1000, 1000 + MOST_OF_ONE):
        assert world.activator.owners.claim(session, "gs-g")
    assert not world.activator.owners.claim(GS_SESSION, "gs-h")


def test_a_lease_that_a_broker_repeats_or_held_back_changes_nothing(world: World) -> None:
    """Not after a newer one, and not of an earlier session of the activator: neither holder nor epoch goes back."""
    old = leases_of(world)
    world.drop = {"init_connect"}
    world.run("activator", world.activator.drones.ask_all(world.now_ms))
    held_back = leases_of(world)[-1]
    world.drop = set()
    world.restart_activator(0x99)
    world.pass_time(3000)
    world.run("gs", world.gs.take_over(1, None, world.now_ms))
    world.pass_time(100)
    of_new_session = leases_of(world)
    for counter in (5, 6):
        taking = {"control": Control.TAKE, "activator_session": 0x99, "counter": counter, "epoch": 9}
        world.run("activator", registration(world, seal("gs-h"), **taking))
    now = control(world)
    assert now[:2] == (OTHER_SESSION, world.activator.leases.epoch(1))
    for publish in (*old, held_back, *of_new_session):
        deliver(world, publish)
        assert control(world) == now


def test_an_offboard_command_lives_by_its_stations_grants(world: World) -> None:
    world.autopilot(heartbeat(armed=True), landed(2), position(10.0))
    world.send(Offboard(60.0, velocity=Velocity(1.0, 0.0, 0.0)))
    world.pass_time(3000)
    offboard_ms = world.uav.desk.executor.lease.offboard_until_ms
    assert offboard_ms is not None
    assert world.now_ms < offboard_ms <= world.now_ms + 3000
    world.drop, dropped_ms = {"control"}, world.now_ms
    allowed: list[int] = []
    while world.now_ms < dropped_ms + 6000:
        world.pass_time(100)
        allowed.append(world.uav.desk.executor.lease.offboard_until_ms or 0)
    assert dropped_ms < max(allowed) <= dropped_ms + 3000


def test_without_a_grant_a_command_goes_by_the_lease_and_what_lasts_ends(world: World) -> None:
    """Grants may be lost with a connection; a hold has an end that its station has signed."""
    world.drop = {"control"}
    world.pass_time(31_000)
    world.autopilot(heartbeat(armed=True), landed(2), position(10.0))
    assert control(world) == (GS_SESSION, 0, False)
    assert kinds(ask(world)) == ["outsiders"]
    world.send(Hold())
    assert len(world.wrote) == 1


def ask(world: World) -> list[Any]:
    """What the drone does when the station that has the lease asks for an object."""
    asked = BulkAsk(gs_session=GS_SESSION, kind="plan", nonce=1, ask=Get(0, 0))
    payload = seal("gs-g").sign("drone1/bulk", encode(asked)).encode()
    return world.hears("uav", "drone1/bulk", payload)


def test_a_grant_is_its_own_stations_and_never_goes_back(world: World) -> None:
    def grant(by: Seal, **changed: Any) -> list[Any]:
        fields = {"gs_session": GS_SESSION, "drone_session": UAV_SESSION, "until_ms": 10**6, **changed}
        payload = by.sign("drone1/control", encode(Grant(**fields))).encode()
        return world.hears("uav", "drone1/control", payload)

    meet(world, seal("gs-h"), OTHER_SESSION)
    assert kinds(grant(seal("gs-h"))) == ["foreign_session"]
    before_ms = world.uav.desk.executor.lease.until_ms
    grant(seal("gs-g"), until_ms=1)
    grant(seal("gs-g"), drone_session=5, until_ms=2**40)
    assert world.uav.desk.executor.lease.until_ms == before_ms
    wide = lease("fog1", holder="g", holder_session=GS_SESSION, deadline_ms=2**40)
    world.hears("uav", "drone1/init_connect", wide.encode())
    assert (world.uav.desk.executor.lease.until_ms or 0) <= world.now_ms + 30_000, "by the grant of this session"
    assert kinds(world.hears("activator", "fog1/drone1/control", seal("gs-h").sign("drone1/control", b"\x80").encode()))


def test_grants_are_bounded() -> None:
    grants = Grants()
    for session in range(1, MOST_GRANTS + 2):
        grants.take("gs-g", Grant(gs_session=session, drone_session=1, until_ms=9, offboard_until_ms=5))
    assert grants.bound("gs-g", 1, 100, 100) == (None, None)
    assert grants.bound("gs-g", 2, 100, None) == (9, None)
    assert grants.bound("gs-h", 2, 100, 100) == (None, None)
    assert grants.bound(None, None, 100, 100) == (None, None)


def test_an_old_answer_to_a_question_for_the_clock_is_no_registration() -> None:
    """On a way of three seconds the question is repeated before the first answer comes, and nobody is registered."""
    fog, role = seal("fog1"), StationRole("g", GS_SESSION, Settings(), seal=seal("gs-g"))
    role.add_fogs([1])
    for effect in role.on_connected("cloud", 0):
        if isinstance(effect, Subscribe):
            role.on_subscribed(effect, 0)

    def hear(topic: str, message: Any, now_ms: int) -> list[Registration]:
        payload = fog.sign(topic, encode(message), with_certificate=True).encode()
        return registrations(role.on_message("cloud", Inbound(topic, payload, 1), now_ms))

    def registrations(outputs: list[Any]) -> list[Registration]:
        found = [one for one in outputs if isinstance(one, Publish) and one.topic == "fog1/init_connect"]
        return [decode(Registration, Envelope.parse(one.payload).payload) for one in found]

    def beacon(fogs_ms: int, asked: Registration) -> BeaconMessage:
        return BeaconMessage(session=FOG_SESSION, now_ms=fogs_ms, nonce=asked.nonce, held_ms=0)

    (first,) = hear("fog1/reachable", FogPresence(session=FOG_SESSION, up=True), 0)
    (second,) = registrations(role.tick(2000))
    assert (first.lease_s, second.lease_s) == (0, 0)
    assert hear("fog1/clock", beacon(9000, first), 3000) == []
    assert not role.fog(1).registered
    (registered,) = registrations(role.tick(3050))
    assert (registered.lease_s, registered.anew) == (30, True)
    assert hear("fog1/clock", beacon(12_050, registered), 6050) == []
    assert role.fog(1).registered
