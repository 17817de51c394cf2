"""Readings that their sensors sign (docs/protocol.md, R12.21): heard of nobody else, from the drone to the station."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mqttxt.core.channel import Channel
from mqttxt.core.effects import Inbound, Log, Publish
from mqttxt.core.settings import Settings
from mqttxt.core.transport import Transport
from mqttxt.drone.effects import Acknowledge, ForgetReadings, LoadReadings, StoreReading
from mqttxt.drone.sensors.carrier import SENSORS
from mqttxt.drone.sensors.store import Batch, SensorStore
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.readings import Reading, ReadingAck, ReadingMessage
from mqttxt.security.cose import Envelope
from mqttxt.security.seal import Seal
from mqttxt.station.outcomes import SensorReading
from sensor.node import SensorNode, SensorOptions
from tests.simulation.carrying import reading
from tests.simulation.signing import seal
from tests.simulation.world import World

KIND = "temperature"


def reader(name: str) -> Seal:
    """A node of a fleet whose sensors sign, which has met nobody."""
    return Seal(seal(name).identity, signs_readings=True)


def said(seq: int, by: str = "sensor1", as_topic: str = f"sensor1/{KIND}", fleet: str = "acme") -> Envelope:
    payload = encode(reading(seq).message)
    return seal(by, fleet=fleet).sign(as_topic, payload, with_certificate=True)


@pytest.fixture
def world() -> World:
    made = World(signed=True, seal=reader, carries_sensors=True).start(1000)
    made.logs.clear()
    made.sent.clear()
    return made


def to_drone(world: World, payload: bytes) -> list[Any]:
    message = Inbound(f"sensor1/{KIND}", payload, 1, False, (9, 4))
    return list(world.uav.on_message(SENSORS, message, world.now_ms))


def carry(world: World, *readings: Reading) -> None:
    """Readings come out of the drone's store."""
    assert world.uav.carrier is not None
    world.run("uav", world.uav.carrier.on_loaded(list(enumerate(readings, 1)), 10, world.now_ms))


def signed_reading(seq: int) -> Reading:
    return Reading(1, KIND, reading(seq).message, said(seq).encode())


def heard(world: World) -> list[int]:
    return [event.seq for event in world.heard if isinstance(event, SensorReading)]


def carried(world: World, topic: str = f"fog1/drone1/sensor1/{KIND}") -> list[Envelope]:
    return [Envelope.parse(publish.payload) for _, publish in world.sent if publish.topic == topic]


def test_a_sensors_reading_is_stored_as_it_signed_it_and_acknowledged_by_the_drone(world: World) -> None:
    assert world.uav.carrier is not None
    (store,) = to_drone(world, said(3).encode())
    assert isinstance(store, StoreReading)
    assert store.reading == Reading(1, KIND, reading(3).message, said(3).encode())
    _, ack, *_ = world.uav.carrier.on_stored([store], world.now_ms)
    assert isinstance(ack, Publish)
    opened = reader("sensor1").open("sensor_ack", ack.payload, "drone1")
    assert decode(ReadingAck, opened.payload).readings == (reading(3).key,)


@pytest.mark.parametrize("what", ["sensor2", "drone1", "gs-g", "fleet", "topic", "unsigned", "flipped", "bare"])
def test_a_drone_stores_nobody_elses(world: World, what: str) -> None:
    payload = {
        "fleet": lambda: said(1, fleet="theirs").encode(),
        "topic": lambda: said(1, as_topic="sensor1/humidity").encode(),
        "unsigned": lambda: encode(reading(1).message),
        "flipped": lambda: said(1).encode().replace(reading(1).message.boot.to_bytes(2), b"\x11\x11"),
        "bare": lambda: said(1).bare().encode(),
    }.get(what, lambda: said(1, by=what).encode())()
    out = to_drone(world, payload)
    assert [type(effect) for effect in out] == [Log, Acknowledge]


def test_a_reading_travels_as_it_was_signed_and_a_station_is_shown_the_certificate_once(world: World) -> None:
    """Who lacks it does not acknowledge; then the reading comes again with it."""
    carry(world, signed_reading(1))
    world.pass_time(1000)
    assert heard(world) == []
    world.pass_time(5000)
    assert heard(world) == [1]
    carry(world, signed_reading(2))
    world.pass_time(500)
    assert heard(world) == [1, 2]
    first, second = carried(world)
    assert [each.certificate is None for each in (first, second)] == [False, True]
    assert (first.payload, first.signature) == (said(1).payload, said(1).signature)
    forgotten = [key.seq for each in world.heard if isinstance(each, ForgetReadings) for key in each.keys]
    assert forgotten == [1, 2]


@pytest.mark.parametrize("by", ["fog1", "drone1", "sensor2", "unsigned"])
@pytest.mark.parametrize("place", ["activator", "gs"])
def test_nobody_makes_up_a_reading_on_its_way(world: World, place: str, by: str) -> None:
    payload = encode(reading(7).message) if by == "unsigned" else said(7, by=by).encode()
    root = "" if place == "activator" else "fog1/"
    assert [type(effect) for effect in world.hears(place, f"{root}drone1/sensor1/{KIND}", payload)] == [Log]


def test_a_reading_that_is_shown_as_another_drones_is_no_new_one(world: World) -> None:
    for drone in (1, 2):
        world.run("gs", world.hears("gs", f"fog1/drone{drone}/sensor1/{KIND}", said(5).encode()))
    assert heard(world) == [5]


def test_a_stored_reading_without_a_signature_keeps_its_place_in_the_store_and_no_other(world: World) -> None:
    carry(world, reading(1), signed_reading(2))
    assert world.logs[0].kind == "unsigned_reading"
    assert len(carried(world, f"drone1/sensor1/{KIND}")) == 1


def test_a_revoked_sensors_readings_make_room_for_others() -> None:
    """Nobody takes them any more; they stay on the disk."""
    drone = reader("drone1")
    world = World(signed=True, seal=lambda name: drone if name == "drone1" else reader(name), carries_sensors=True)
    world.start(1000)
    carry(world, signed_reading(1))
    fleet, certificate = drone.identity.fleet, seal("sensor1").certificate
    fleet.take(replace(fleet.revoked, number=fleet.revoked.number + 1, serials=frozenset({certificate.serial})))
    world.pass_time(5000)
    assert "sensor_certificate" in [effect.kind for effect in world.logs]
    loads = [effect for effect in world.heard if isinstance(effect, LoadReadings)]
    assert loads[-1].most == 32


def test_the_store_keeps_signatures_over_a_restart(tmp_path: Path) -> None:
    stored = [signed_reading(1), reading(2)]
    store = SensorStore(tmp_path / "sensors")
    store.carry_out(Batch(store=[StoreReading(each, None) for each in stored]))
    store.close()
    found = SensorStore(tmp_path / "sensors").carry_out(Batch(load=LoadReadings(0, 10)))
    assert [each for _, each in found.rows] == stored


def test_a_sensor_signs_and_believes_drones_alone() -> None:
    node = SensorNode(7, SensorOptions(kinds=(KIND,), samples=1), Settings(), lambda: 0, reader("sensor1"))
    node.on_connected("broker", 0)
    (publish,) = [each for each in node.on_subscribed(None, 0) + node.tick(10) if isinstance(each, Publish)]  # type: ignore[arg-type]
    key = decode(ReadingMessage, reader("drone1").open(publish.topic, publish.payload, "sensor1").payload)
    ack = encode(ReadingAck(readings=(Reading(1, KIND, key).key,)))
    for name in ("sensor2", "fog1", "gs-g"):
        forged = seal(name).sign("sensor_ack", ack, with_certificate=True).encode()
        assert [type(each) for each in node.on_message("broker", Inbound("sensor_ack", forged, 1), 20)] == [Log]
    assert [type(each) for each in node.on_message("broker", Inbound("sensor_ack", ack, 1), 20)] == [Log]
    own = seal("drone1").sign("sensor_ack", ack, with_certificate=True).encode()
    node.on_message("broker", Inbound("sensor_ack", own, 1), 30)
    assert [type(each).__name__ for each in node.tick(40)] == ["Finished"]


def test_readings_are_signed_only_beside_all_else() -> None:
    with pytest.raises(ConfigurationError, match="`signed_readings`: expected `signed` beside it"):
        Transport().seal(signed=False, signed_readings=True)


def test_the_price_of_a_signature() -> None:
    plain = encode(reading(1).message)
    assert len(said(1).bare().encode()) - len(plain) == 80
    assert Channel("fog", "", Settings()).opened_reading(plain, 1, KIND) == plain
