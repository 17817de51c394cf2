"""Readings where messages are signed (docs/protocol.md, R12.19): a drone gives them up at a station's word alone."""

from __future__ import annotations

import pytest

from mqttxt.activator.sensor_relay import MOST_WAITING, Carried
from mqttxt.core.effects import Log
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import ForgetReadings
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.readings import MOST_ACKNOWLEDGED, ReadingAck
from mqttxt.security.cose import Envelope
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from mqttxt.station.outcomes import SensorReading
from mqttxt.station.role import StationRole
from tests.simulation.carrying import reading
from tests.simulation.signing import seal
from tests.simulation.world import World

ACK = "drone1/sensor_ack"


@pytest.fixture
def world() -> World:
    """A drone that carries sensors, in a fleet that signs, and a station that is registered."""
    made = World(signed=True, carries_sensors=True).start(1000)
    made.logs.clear()
    return made


def carry(world: World, *seqs: int) -> None:
    """Readings come out of the drone's store."""
    assert world.uav.carrier is not None
    rows = [(seq, reading(seq)) for seq in seqs]
    world.run("uav", world.uav.carrier.on_loaded(rows, len(rows), world.now_ms))


def forgotten(world: World) -> list[int]:
    return [key.seq for effect in world.heard if isinstance(effect, ForgetReadings) for key in effect.keys]


def acks(world: World, topic: str = ACK) -> list[bytes]:
    return [publish.payload for _, publish in world.sent if publish.topic == topic]


def ack_of(by: Seal, *seqs: int, topic: str = ACK) -> bytes:
    keys = tuple(reading(seq).key for seq in seqs)
    return by.sign(topic, encode(ReadingAck(readings=keys)), with_certificate=True).encode()


def test_a_reading_leaves_the_drone_when_a_station_says_that_it_has_it(world: World) -> None:
    carry(world, 1, 2)
    assert forgotten(world) == []
    world.pass_time(100)
    assert [each.seq for each in world.heard if isinstance(each, SensorReading)] == [1, 2]
    assert forgotten(world) == [1, 2]
    (passed_on,) = acks(world)
    assert passed_on == acks(world, "fog1/drone1/sensor_ack")[0]


def test_a_broker_that_takes_readings_and_delivers_none_empties_no_store(world: World) -> None:
    world.deafen("gs")
    carry(world, 1)
    ref = Carried(1, reading(1).key)
    world.run("activator", world.activator.on_published("cloud", ref, 0, world.now_ms))
    world.pass_time(500)
    assert (acks(world), forgotten(world)) == ([], [])


def test_a_reading_that_comes_again_is_acknowledged_again_and_told_once(world: World) -> None:
    world.drop = {"sensor_ack"}
    carry(world, 1)
    world.pass_time(1000)
    world.drop = set()
    world.pass_time(5000)  # the drone says it again
    assert forgotten(world) == [1]
    assert len([each for each in world.heard if isinstance(each, SensorReading)]) == 1


@pytest.mark.parametrize("by", ["fog1", "drone1", "gs-nobody", "sensor1", "another fleet", "another topic", "unsigned"])
def test_nobody_elses_acknowledgement_counts(world: World, by: str) -> None:
    world.drop = {"sensor_ack"}
    carry(world, 1)
    world.drop = set()
    forged = {
        "gs-nobody": lambda: ack_of(seal("gs-nobody", Rights()), 1),
        "another fleet": lambda: ack_of(seal("gs-g", fleet="other"), 1),
        "another topic": lambda: ack_of(seal("gs-g"), 1, topic="drone2/sensor_ack"),
        "unsigned": lambda: encode(ReadingAck(readings=(reading(1).key,))),
    }.get(by, lambda: ack_of(seal(by), 1))()
    for node, topic in (("uav", ACK), ("activator", "fog1/drone1/sensor_ack")):
        assert [type(effect) for effect in world.hears(node, topic, forged)] == [Log]


def test_who_may_only_observe_may_acknowledge(world: World) -> None:
    watcher = StationRole("sees", 0x57, Settings(), control=False, seal=seal("gs-sees", Rights(observe=True)))
    world.run("gs", world.gs.goodbye(world.now_ms))
    world.deafen("gs")
    world.gs = watcher
    world.gs.add_fogs([1])
    world.run("gs", world.gs.on_connected("cloud", world.now_ms))
    world.pass_time(1000)
    carry(world, 1)
    world.pass_time(100)
    assert forgotten(world) == [1]


def test_what_nobody_waits_for_is_not_passed_on(world: World) -> None:
    """Two stations hear the same readings: the air link carries one word of it."""
    carry(world, 1)
    world.pass_time(100)
    again = ack_of(seal("gs-g"), 1)
    assert world.hears("activator", "fog1/" + ACK, again) == []
    for seq in range(10, 10 + 2 * MOST_WAITING):
        world.activator.sensors._wait(1, reading(seq).key)
    assert len(world.activator.sensors._waiting[1]) == MOST_WAITING


def test_many_readings_are_acknowledged_in_as_few_messages_as_they_fit_in(world: World) -> None:
    carry(world, *range(MOST_ACKNOWLEDGED + 20))
    world.pass_time(100)
    sent = [decode(ReadingAck, Envelope.parse(payload).payload) for payload in acks(world, "fog1/" + ACK)]
    assert [len(ack.readings) for ack in sent] == [MOST_ACKNOWLEDGED, 20]


def test_without_a_registration_nothing_is_acknowledged(world: World) -> None:
    world.gs.fogs[1].registered = False
    carry(world, 1)
    world.run("gs", world.gs.tick(world.now_ms))
    assert acks(world, "fog1/" + ACK) == []
