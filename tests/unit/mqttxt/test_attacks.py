"""What one client of an open broker can do to a fleet, tried at a fleet that signs.

Each attack is first made in an open fleet, where it does harm, so that it is one. In a fleet that signs nothing comes
of it, whoever makes it: somebody without a key, a member of the fleet in its own name, and a member of another fleet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from mqttxt.activator import command_relay
from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.core.effects import Publish
from mqttxt.core.ledger import CAPACITY
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import ForgetReadings
from mqttxt.drone.options import UavOptions
from mqttxt.drone.role import UavClient
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Land
from mqttxt.protocol.control import Control, DroneLease, DroneRecord, Registration
from mqttxt.protocol.messages import BeaconMessage, FogPresence, Presence, ResultMessage, Word
from mqttxt.protocol.readings import ReadingAck
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import Location
from mqttxt.protocol.values import Encoding
from mqttxt.security.addressed import Addressed
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from mqttxt.station.outcomes import Outcome
from tests.simulation.carrying import reading
from tests.simulation.signing import seal
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION, World, ack, command_payload, heartbeat, ready

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True)
def _ledger_that_fills_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command_relay, "FOG_CAPACITY", CAPACITY)


LAST = 2**32 - 1
EVE = 0xE7E


@dataclass
class Attacker:
    """One client of both brokers, which says what it likes; with a seal in its own name, else without a signature."""

    world: World
    seal: Seal | None

    def say(self, link: str, topic: str, message: object, *, retain: bool = False) -> None:
        payload = message if isinstance(message, bytes) else self._signed(topic, encode(message))
        self.world.route("attacker", Publish(link, topic, payload, 1, retain))

    def _signed(self, topic: str, payload: bytes) -> bytes:
        if self.seal is None:
            return payload
        is_cloud_side = topic.startswith("fog1/drone")
        of_drone = is_cloud_side and not topic.endswith(("/reachable", "/clock"))
        envelope = self.seal.sign(topic.removeprefix("fog1/") if of_drone else topic, payload, with_certificate=True)
        if is_cloud_side and topic.endswith("/commands"):
            return Addressed(FOG_SESSION, 10**6, {1: envelope}).encode()
        return envelope.encode()


def take_over(attacker: Attacker) -> None:
    """Cloud: a takeover with the last epoch."""
    registration = Registration(
        name="eve",
        session=EVE,
        nonce=1,
        lease_s=3600,
        control=Control.TAKE,
        epoch=LAST,
        until_ms=10**6 if attacker.seal is not None else None,
        activator_session=FOG_SESSION if attacker.seal is not None else None,
        counter=1 if attacker.seal is not None else None,
    )
    attacker.say(CLOUD, "gs/eve/reachable", Presence(session=EVE, up=True))
    attacker.say(CLOUD, "fog1/init_connect", registration)


def command_in_the_stations_name(attacker: Attacker) -> None:
    """Cloud: with its session and the last number, after which its own are overtaken."""
    soon_ms = attacker.world.now_ms + 5000
    command = command_payload(Land(), seq=LAST, executor_session=FOG_SESSION, deadline_ms=soon_ms, epoch=LAST)
    attacker.say(CLOUD, "fog1/drone1/commands", command)


def result_of_the_fog(attacker: Attacker) -> None:
    """Cloud: a forged word on a command that is under way."""
    _send_into_the_dark(attacker.world)
    attacker.say(CLOUD, "fog1/drone1/commands_result/arm", _completed(attacker.world))


def result_of_the_drone(attacker: Attacker) -> None:
    """Fog: the same from below."""
    _send_into_the_dark(attacker.world)
    attacker.say(FOG, "drone1/commands_result/arm", _completed(attacker.world))


def activator_impersonated(attacker: Attacker) -> None:
    """Cloud: another activator is born, and counts its own drones."""
    for _ in range(2):  # who was put right by the activator just now is asked to wait for the next time
        attacker.say(CLOUD, "fog1/reachable", FogPresence(session=EVE, up=True), retain=True)
        attacker.say(CLOUD, "fog1/clock", BeaconMessage(session=EVE, now_ms=1))
    attacker.world.pass_time(200)
    _note(attacker, not attacker.world.gs.fogs[1].registered or attacker.world.gs.fogs[1].session == EVE)


def beacons_ahead(attacker: Attacker) -> None:
    """Both: a beacon 20 s ahead, after which a command that is held back for 4 s is executed late."""
    world = attacker.world
    ahead_ms = world.now_ms + 20_000
    attacker.say(CLOUD, "fog1/clock", BeaconMessage(session=FOG_SESSION, now_ms=ahead_ms))
    for link, topic in ((CLOUD, "fog1/drone1/clock"), (FOG, "drone1/clock")):
        attacker.say(link, topic, BeaconMessage(session=UAV_SESSION, now_ms=ahead_ms))
    world.drop = {"commands"}
    world.send(Arm(), ttl_ms=1000)
    world.drop = set()
    held = [publish for sender, publish in world.sent if sender == "gs" and publish.topic.endswith("/commands")][-1]
    world.pass_time(4000)
    world.route("gs", held)


def station_down(attacker: Attacker) -> None:
    """Cloud: the station's will."""
    attacker.say(CLOUD, "gs/g/reachable", Presence(session=GS_SESSION, up=False), retain=True)
    _note(attacker, not attacker.world.activator.leases.controls(GS_SESSION, 1))


def fog_down(attacker: Attacker) -> None:
    """Cloud: the activator's will."""
    attacker.say(CLOUD, "fog1/reachable", FogPresence(session=FOG_SESSION, up=False), retain=True)
    _note(attacker, not attacker.world.gs.fogs[1].up)


def drone_record(attacker: Attacker) -> None:
    """Cloud: the drone is gone, and another's."""
    record = DroneRecord(activator_session=FOG_SESSION, up=False, holder="eve", holder_session=EVE, epoch=LAST)
    attacker.say(CLOUD, "fog1/drone1/reachable", record, retain=True)
    _note(attacker, not attacker.world.gs.fogs[1].drones[1].reachable)


def a_thousand_registrations(attacker: Attacker) -> None:
    """Cloud: for an hour each, so that a station that comes later is refused."""
    world = attacker.world
    world.run("gs", world.gs.goodbye(world.now_ms))
    for number in range(1001):
        given = {"until_ms": 10**6, "activator_session": FOG_SESSION, "counter": 1} if attacker.seal is not None else {}
        registration = Registration(name="eve", session=EVE + number, nonce=1, lease_s=3600, **given)
        attacker.say(CLOUD, "fog1/init_connect", registration)
    world.run("gs", world.gs.on_connected(CLOUD, world.now_ms))
    world.pass_time(3000)


def a_filled_ledger(attacker: Attacker) -> None:
    """Cloud: questions in the station's name, as many as the activator remembers of what is never refused."""
    for seq in range(4000):
        asked = command_payload(Land(), seq=LAST - seq, executor_session=FOG_SESSION, deadline_ms=0)
        attacker.say(CLOUD, "fog1/drone1/commands", asked)
        if seq % 40 == 0:
            attacker.world.pass_time(100)


def a_forged_state(attacker: Attacker) -> None:
    """Cloud: the drone is somewhere else."""
    place = Location(0.0, 0.0, 0.0, 0.0)
    encoded = encode_state(StampedState(place, 0xFF, 0xFF), Encoding.CBOR)
    attacker.say(CLOUD, "fog1/drone1/state/location", encoded)
    known = attacker.world.gs.fogs[1].drones[1].states.get("location")
    _note(attacker, known is not None and known.message.state == place)


def retained_garbage(attacker: Attacker) -> None:
    """Cloud: an epoch at its end is retained, and met by an activator that starts."""
    record = DroneRecord(activator_session=EVE, up=False, epoch=LAST)
    attacker.say(CLOUD, "fog1/drone1/reachable", record, retain=True)
    for topic in ("fog1/drone2/reachable", "gs/g/reachable", "fog1/reachable"):
        attacker.say(CLOUD, topic, b"\xff garbage", retain=True)
    attacker.world.restart_activator(FOG_SESSION + 1)
    attacker.world.pass_time(5000)
    _note(attacker, attacker.world.activator.leases.epoch(1) == LAST)


def command_past_the_activator(attacker: Attacker) -> None:
    """Fog: straight to the UAV client, in nobody's name, under an epoch like a new holder's."""
    soon_ms = attacker.world.now_ms + 5000
    attacker.say(FOG, "drone1/commands", command_payload(Arm(), gs_session=EVE, epoch=1, deadline_ms=soon_ms))


def second_client_of_the_drone(attacker: Attacker) -> None:
    """Fog: a lease that ends the client in flight."""
    attacker.say(FOG, "drone1/init_connect", _lease(attacker, bound=False))


def lease_of_the_last_epoch(attacker: Attacker) -> None:
    """Fog: every command is refused from then on, also without a holder."""
    attacker.say(FOG, "drone1/init_connect", _lease(attacker, bound=True, epoch=LAST))


def lease_without_a_holder(attacker: Attacker) -> None:
    """Fog: nobody controls the drone, so that an offboard command ends."""
    attacker.say(FOG, "drone1/init_connect", _lease(attacker, bound=True))
    _note(attacker, not attacker.world.uav.is_controlled(attacker.world.now_ms))


def drone_down(attacker: Attacker) -> None:
    """Fog: the drone's will."""
    attacker.say(FOG, "drone1/reachable", Presence(session=UAV_SESSION, up=False), retain=True)
    _note(attacker, not attacker.world.gs.fogs[1].drones[1].reachable)


def stored_readings(attacker: Attacker) -> None:
    """Fog: an acknowledgement that empties the drone's store, of a reading that no station has heard."""
    world = attacker.world
    assert world.uav.carrier is not None
    world.drop = {"temperature"}
    world.run("uav", world.uav.carrier.on_loaded([(1, reading(1))], 1, world.now_ms))
    attacker.say(FOG, "drone1/sensor_ack", ReadingAck(readings=(reading(1).key,)))


def fake_drones(attacker: Attacker) -> None:
    """Fog: 249 drones that a broadcast waits for."""
    for drone in range(2, 251):
        attacker.say(FOG, f"drone{drone}/reachable", Presence(session=drone, up=True), retain=True)
        attacker.say(FOG, f"drone{drone}/clock", BeaconMessage(session=drone, now_ms=1, nonce=1, held_ms=0))
    _note(attacker, len(attacker.world.activator.drones.roster()) > 2)  # itself, where the attacker is a drone


ATTACKS: tuple[Callable[[Attacker], None], ...] = (
    *(take_over, command_in_the_stations_name, result_of_the_fog, result_of_the_drone, activator_impersonated),
    *(beacons_ahead, station_down, fog_down, drone_record, a_thousand_registrations, a_filled_ledger, a_forged_state),
    *(retained_garbage, command_past_the_activator, second_client_of_the_drone, lease_of_the_last_epoch),
    *(lease_without_a_holder, drone_down, stored_readings, fake_drones),
)
SEEN = "seen"


def _note(attacker: Attacker, is_harm: bool) -> None:
    """What is put right by itself later counts too."""
    if is_harm:
        attacker.world.heard.append(SEEN)


def _send_into_the_dark(world: World) -> None:
    """A command that does not reach the drone."""
    world.drop = {"commands"}
    world.send(Arm(), ttl_ms=3000)
    world.drop = set()


def _completed(world: World) -> ResultMessage:
    (seq,) = {command_id.seq for command_id in world.gs.commands.pending}
    return ResultMessage(
        gs_session=GS_SESSION, seq=seq, session=UAV_SESSION, stamp=1, relay_stamp=1, word=Word.COMPLETED
    )


def _lease(attacker: Attacker, *, bound: bool, epoch: int = 0) -> DroneLease:
    signed = {"counter": LAST, "heard_ms": 2**53 - 1} if attacker.seal is not None else {}
    return DroneLease(
        activator_session=FOG_SESSION, drone_session=UAV_SESSION, nonce=1, bound=bound, epoch=epoch, **signed
    )


def attacked(attack: Callable[[Attacker], None], by: Seal | None, signed: bool) -> list[str]:
    """Make an attack on a drone that station g controls, and say which harm it did."""
    world = World(signed=signed)
    options = UavOptions(carries_sensors=True)
    sealed = {"seal": seal("drone1"), "fog": 1} if signed else {}
    if signed:
        world.seal = lambda name: Seal(seal(name).identity, signs_states=True)
        sealed["seal"] = world.seal("drone1")
        world.__post_init__()
    world.uav = UavClient(1, UAV_SESSION, Settings(), options=options, **sealed)
    ready(world.uav)
    world.start().pass_time(2000)
    assert world.gs.fogs[1].controls(1)
    world.wrote.clear()
    world.heard.clear()
    attack(Attacker(world, by))
    world.pass_time(6000)
    harm = [f"wrote {effect.message.get_type()}" for effect in world.wrote]
    harm += [f"stopped: {stop.reason}" for stop in world.stops]
    harm += [str(event) for event in world.heard if event == SEEN or isinstance(event, ForgetReadings)]
    harm += ["completed" for event in world.heard if isinstance(event, Outcome) and event.word is Word.COMPLETED]
    return harm + _not_flown(world)


def _not_flown(world: World) -> list[str]:
    """What keeps station g from flying its drone now."""
    fog = world.gs.fogs[1]
    if not (fog.registered and fog.controls(1) and fog.drones[1].reachable):
        return ["g does not control the drone"]
    world.wrote.clear()
    world.heard.clear()
    sent = world.send(Land())
    world.autopilot(heartbeat(armed=True), ack(21))
    words = [event.word for event in world.heard if isinstance(event, Outcome) and event.id == sent]
    return [] if Word.ACCEPTED in words else [f"land: {words}"]


@pytest.mark.parametrize("signed", [False, True])
def test_nobody_does_no_harm(signed: bool) -> None:
    assert attacked(lambda _: None, None, signed) == []


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
def test_an_open_fleet_is_harmed(attack: Callable[[Attacker], None]) -> None:
    assert attacked(attack, None, signed=False) != []


BY = {
    "nobody": None,
    "a station that observes": seal("gs-eve", Rights(observe=True)),
    "a neighbour": seal("fog2"),
    "another drone": seal("drone2"),
    "another fleet": seal("fog1", fleet="theirs"),
}


MAY = (stored_readings, "a station that observes")
"""It hears readings, and says so (R12.19)."""


@pytest.mark.parametrize("by", BY)
@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
def test_a_fleet_that_signs_is_not(attack: Callable[[Attacker], None], by: str) -> None:
    assert (attacked(attack, BY[by], signed=True) == []) is ((attack, by) != MAY)
