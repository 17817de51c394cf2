"""Each reading comes once at the station, however often it was sent."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mqttxt.core.effects import Log
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.readings import ReadingAck
from mqttxt.station.outcomes import SensorReading
from mqttxt.station.readings import MOST_RANGES, Readings, SeenNumbers
from tests.simulation.carrying import reading
from tests.simulation.fogs import BORN_MS, ActivatorBench, of
from tests.simulation.world import World


@given(st.lists(st.integers(0, 60), max_size=200))
def test_a_number_is_new_exactly_once(numbers: list[int]) -> None:
    seen, known = SeenNumbers(), set()
    for number in numbers:
        assert seen.add(number) == (number not in known)
        known.add(number)


def test_numbers_in_their_order_take_no_room() -> None:
    seen = SeenNumbers()
    assert all(seen.add(number) for number in range(10_000))
    assert seen._ranges == [[0, 9999]]


def test_gaps_beyond_number_are_closed_from_the_oldest_on() -> None:
    seen = SeenNumbers()
    assert all(seen.add(2 * number) for number in range(3 * MOST_RANGES))
    assert len(seen._ranges) == MOST_RANGES
    assert not seen.add(1)
    assert seen.add(2 * 3 * MOST_RANGES - 3)


def test_the_newest_of_each_kind_is_kept_whatever_came_last() -> None:
    readings = Readings()
    readings.on_reading(1, 1, reading(5, value=5.0))
    readings.on_reading(1, 1, reading(4, value=4.0))
    assert readings.latest[1, 1, "temperature"].value == 5.0


def test_a_drone_that_changed_its_fog_does_not_double_its_readings() -> None:
    readings = Readings()
    assert len(readings.on_reading(1, 3, reading(0))) == 1
    assert readings.on_reading(2, 3, reading(0)) == []
    assert len(readings.on_reading(2, 4, reading(0))) == 1


def test_a_reading_at_the_station_is_an_event_with_its_unit() -> None:
    world = World().start()
    topic, payload = "fog1/drone1/sensor3/humidity", encode(reading(8, value=40.5).message)
    (event,) = world.hears("gs", topic, payload)
    assert isinstance(event, SensorReading)
    assert str(event) == "drone 1 sensor 3: humidity 40.5 %"
    assert world.hears("gs", topic, payload) == []
    (log,) = world.hears("gs", topic, b"{}")
    assert isinstance(log, Log)


def test_an_activator_passes_readings_on_outside_of_the_gate_and_acknowledges_what_somebody_got() -> None:
    bench = ActivatorBench()
    bench.appear()
    payload = encode(reading(2).message)
    (publish,) = of(bench.fog("drone1/sensor1/temperature", payload), "fog1/drone1/sensor1/temperature")
    assert (publish.qos, publish.retain, publish.payload) == (1, False, payload)
    bench.role.on_published("cloud", publish.ref, 0x10, BORN_MS)
    assert of(bench.role.tick(BORN_MS + 100), "drone1/sensor_ack") == []
    bench.register()
    (publish,) = of(bench.fog("drone1/sensor1/temperature", payload), "fog1/drone1/sensor1/temperature")
    bench.role.on_published("cloud", publish.ref, 0, BORN_MS)
    (ack,) = of(bench.role.tick(BORN_MS + 200), "drone1/sensor_ack")
    assert decode(ReadingAck, ack.payload).readings == (reading(2).key,)


def test_an_activator_that_is_not_born_leaves_readings_on_the_drone() -> None:
    bench = ActivatorBench(born=False)
    assert bench.fog("drone1/sensor1/temperature", encode(reading(2).message)) == []


def test_a_malformed_reading_from_a_drone_is_counted() -> None:
    bench = ActivatorBench()
    (log,) = bench.fog("drone1/sensor1/temperature", b"\x81\x01")
    assert isinstance(log, Log)
    (log,) = bench.fog("drone1/sensor0/temperature", encode(reading(2).message))
    assert isinstance(log, Log)
    assert log.kind == "topic"
