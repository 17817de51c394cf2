"""Readings from a drone's broker to the station: kept until they are safe, oldest first, each one once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mqttxt.activator.sensor_relay import MOST_WAITING, Carried
from mqttxt.core.channel import Channel
from mqttxt.core.effects import Inbound, Log, Publish, Subscribe
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import Acknowledge, ForgetReadings, LoadReadings, StoreReading
from mqttxt.drone.options import UavOptions
from mqttxt.drone.role import UavClient
from mqttxt.drone.sensors.carrier import WINDOW, Carrier
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.control import DroneLease
from mqttxt.protocol.readings import ReadingAck, ReadingKey
from mqttxt.protocol.topics import FogSide
from tests.examples import examples
from tests.simulation.carrying import BOOT, LINK, Way, carried, inbound, reading
from tests.simulation.world import UAV_SESSION


@pytest.fixture
def way(tmp_path: Path) -> Way:
    return Way(tmp_path / "sensors")


def carrier() -> Carrier:
    return Carrier(1, Channel(LINK, "", Settings()), FogSide())


def full(made: Carrier, count: int = WINDOW) -> list[Any]:
    """The fog is there and `count` readings are under way, acknowledged by the fog's broker."""
    made.on_fog_up(0)
    out = made.on_loaded([(n + 1, reading(n)) for n in range(count)], WINDOW, 0)
    for n in range(count):
        made.on_published(reading(n).key, 0, 0)
    return out


def acknowledged(*numbers: int) -> Inbound:
    keys = tuple(reading(number).key for number in numbers)
    return Inbound("drone1/sensor_ack", encode(ReadingAck(readings=keys)), 1)


def test_a_reading_is_acknowledged_only_once_it_is_stored() -> None:
    made = carrier()
    (store,) = made.on_message(inbound(reading(3), receipt=(9, 4)), 0)
    assert store == StoreReading(reading(3), (9, 4))
    receipt, ack = made.on_stored([store], 0)
    assert receipt == Acknowledge("sensors", (9, 4))
    assert isinstance(ack, Publish)
    assert (ack.link, ack.topic, ack.qos) == ("sensors", "sensor_ack", 1)
    assert decode(ReadingAck, ack.payload).readings == (ReadingKey(sensor=1, boot=BOOT, seq=3),)


def test_the_drones_own_revocation_list_is_no_reading() -> None:
    made = carrier()
    assert made.on_message(Inbound("fleet/revoked", b"a list", 1, True, (9, 4)), 0) == [Acknowledge("sensors", (9, 4))]


def test_a_reading_that_was_refused_stays_with_its_sensor_and_frees_the_brokers_window() -> None:
    out = carrier().on_refused([StoreReading(reading(0), (9, 4)), StoreReading(reading(1), None)], "full", 0)
    assert [type(effect) for effect in out] == [Log, Acknowledge, Log]
    assert "full; new readings stay with their sensors" in out[0].detail  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("topic", "payload", "kind", "why"),
    [
        ("sensor0/temperature", None, "sensor_topic", "expected sensor and a number from 1"),
        ("sensor01/temperature", None, "sensor_topic", "expected sensor and a number from 1"),
        ("sensor1234567890/light", None, "sensor_topic", "expected sensor and a number from 1"),
        ("weather/light", None, "sensor_topic", "not a sensor's"),
        ("sensor1/Light", None, "sensor_topic", "lower-case letters"),
        ("sensor1/", None, "sensor_topic", "lower-case letters"),
        ("sensor1/temperature", b"21.5", "sensor_reading", "payload"),
        ("sensor1/temperature", b"", "sensor_reading", "got nothing"),
        ("sensor1/temperature", b'{"version":1,"boot":1,"seq":0,"time_ms":0,"value":NaN}', "sensor_reading", "NaN"),
        ("sensor1/temperature", b'{"version":2,"boot":1,"seq":0,"time_ms":0,"value":1}', "sensor_reading", "version"),
        ("sensor1/temperature", b'{"version":1,"boot":0,"seq":0,"time_ms":0,"value":1}', "sensor_reading", "boot"),
        ("sensor1/temperature", b'{"version":1,"boot":1,"seq":-1,"time_ms":0,"value":1}', "sensor_reading", "seq"),
        ("sensor1/temperature", b'{"version":1,"boot":1,"seq":0,"time_ms":-1,"value":1}', "sensor_reading", "time_ms"),
        ("sensor1/temperature", b'{"version":1,"boot":1,"seq":0,"time_ms":0,"value":"1"}', "sensor_reading", "value"),
        ("sensor1/temperature", b'{"version":1,"boot":1,"seq":0,"time_ms":0,"value":1e999}', "sensor_reading", "value"),
        (
            "sensor1/temperature",
            b'{"version":1,"boot":1,"seq":0,"time_ms":0,"value":1,"unit":"degF"}',
            "sensor_reading",
            "expected degC for temperature, or none, got 'degF'",
        ),
        (
            "sensor1/wind",
            b'{"version":1,"boot":1,"seq":0,"time_ms":0,"value":1,"unit":"m\\u001b/s"}',
            "sensor_reading",
            "printable",
        ),
    ],
)
def test_bad_readings_are_counted_dropped_and_do_not_block_the_next(
    topic: str, payload: bytes | None, kind: str, why: str
) -> None:
    body = encode(reading().message) if payload is None else payload
    log, receipt = carrier().on_message(Inbound(topic, body, 1, False, (1, 2)), 0)
    assert isinstance(log, Log)
    assert log.kind == kind
    assert why in log.detail
    assert receipt == Acknowledge("sensors", (1, 2))


def test_readings_of_kinds_that_nobody_knows_travel_with_their_unit(way: Way) -> None:
    way.take(way.carrier.on_message(inbound(reading(0, kind="wind_speed", unit="m/s", value=3.25)), 0))
    way.take(way.carrier.on_message(inbound(reading(1, kind="ph", value=7)), 0))
    way.settle()
    assert [(r.kind, r.value, r.unit) for r in way.heard] == [("wind_speed", 3.25, "m/s"), ("ph", 7.0, "")]


def test_no_more_than_a_window_is_under_way_and_more_follows_what_was_acknowledged() -> None:
    made = carrier()
    assert made.on_fog_up(0) == [LoadReadings(0, WINDOW)]
    assert carried(made.on_loaded([(n + 1, reading(n)) for n in range(WINDOW)], WINDOW, 0)) == list(range(WINDOW))
    assert made.tick(1000) == []
    out = made.on_ack(acknowledged(0, 1), 1000)
    assert out == [ForgetReadings((reading(0).key, reading(1).key)), LoadReadings(WINDOW, 2)]


def test_nothing_goes_out_and_nothing_is_loaded_while_the_fog_is_away() -> None:
    made = carrier()
    assert [type(e) for e in made.on_stored([StoreReading(reading(0))], 0)] == [Publish]
    assert made.tick(10_000) == []
    full(made)
    made.on_fog_down()
    assert made.tick(60_000) == []


def test_what_the_activator_does_not_acknowledge_is_sent_again_after_2_4_8_and_16_seconds() -> None:
    made = carrier()
    full(made, 1)
    times = [now_ms for now_ms in range(0, 65_000, 50) if carried(made.tick(now_ms))]
    assert times == [2000, 6000, 14_000, 30_000, 46_000, 62_000]


def test_while_the_broker_has_not_taken_a_reading_the_transport_repeats_it() -> None:
    made = carrier()
    made.on_fog_up(0)
    made.on_loaded([(1, reading(0))], WINDOW, 0)
    assert made.tick(60_000) == []


def test_a_new_connection_and_a_new_activator_get_what_is_under_way_at_once() -> None:
    made = carrier()
    full(made, 3)
    made.on_new_activator(500)
    assert carried(made.tick(500)) == [0, 1, 2]
    made.on_fog_down()
    assert carried(made.on_fog_up(700)) == [0, 1, 2]


def test_an_acknowledgement_of_what_is_not_under_way_empties_the_store_all_the_same(way: Way) -> None:
    way.measure(0)
    way.work()
    assert way.store is not None
    assert len(way.store) == 1
    way.take(way.carrier.on_ack(acknowledged(0), 0))
    way.work()
    assert len(way.store) == 0


def test_an_outage_is_made_up_for_oldest_first(way: Way) -> None:
    way.measure(*range(100))
    way.settle()
    assert [r.seq for r in way.heard] == list(range(100))
    assert way.store is not None
    assert len(way.store) == 0


@pytest.mark.parametrize("says_nobody", [True, False])
def test_while_no_station_listens_readings_stay_on_the_drone(way: Way, says_nobody: bool) -> None:
    """Also where the broker leaves out that nobody subscribes, as it may."""
    way.says_nobody = says_nobody
    way.listens = False
    way.register()
    way.measure(0, 1)
    way.settle()
    assert way.store is not None
    assert (len(way.store), way.heard) == (2, [])
    way.listens = True
    way.register()
    way.settle()
    assert [r.seq for r in way.heard] == [0, 1]


def test_a_station_that_registers_behind_a_reading_has_not_heard_it(way: Way) -> None:
    way.says_nobody = way.listens = False
    way.register()
    way.measure(0)
    way.connect()
    way.work()
    way.to_the_activator()
    way.to_the_station()
    way.listens = True
    way.register()
    way.back_to_the_drone()
    assert way.store is not None
    assert len(way.store) == 1
    way.settle()
    assert [r.seq for r in way.heard] == [0]


def test_a_repeated_reading_is_forwarded_once_while_the_cloud_has_not_answered(way: Way) -> None:
    way.measure(0)
    way.connect()
    way.work()
    (sent,) = way.to_fog
    topic, message = FogSide().parse(sent.topic), Inbound(sent.topic, sent.payload)
    assert len(way.relay.on_reading(topic, message, 0)) == 1
    assert way.relay.on_reading(topic, message, 0) == []
    way.relay.on_cloud_down()
    assert len(way.relay.on_reading(topic, message, 0)) == 1


def test_a_drone_that_sends_more_than_it_may_does_not_fill_the_activators_memory(way: Way) -> None:
    topic = FogSide().parse("drone1/sensor1/temperature")
    sent = [
        effect
        for seq in range(MOST_WAITING + 50)
        for effect in way.relay.on_reading(topic, Inbound("", encode(reading(seq).message)), 0)
    ]
    assert len(sent) == MOST_WAITING
    way.relay.on_published(Carried(1, reading(0).key), 0, 0)
    assert len(way.relay.on_reading(topic, Inbound("", encode(reading(MOST_WAITING).message)), 0)) == 1


def test_two_sensors_of_one_number_both_pass(way: Way) -> None:
    for boot in (1, 2):
        way.take(way.carrier.on_message(inbound(reading(0, boot=boot, value=boot)), 0))
    way.settle()
    assert [(r.boot, r.seq, r.value) for r in way.heard] == [(1, 0, 1.0), (2, 0, 2.0)]


def test_a_uav_client_that_carries_hears_acknowledgements_and_repeats_for_a_new_activator() -> None:
    client = UavClient(1, UAV_SESSION, Settings(), options=UavOptions(carries_sensors=True))
    assert client.carrier is not None
    subscribes = [e for e in client.on_connected("fog", 0) if isinstance(e, Subscribe)]
    assert "drone1/sensor_ack" in subscribes[1].filters
    out = [effect for subscribe in subscribes for effect in client.on_subscribed(subscribe, 0)]
    assert LoadReadings(0, WINDOW) in out
    (publish,) = client.carrier.on_loaded([(1, reading(0))], WINDOW, 0)[:1]
    assert isinstance(publish, Publish)
    assert (publish.topic, publish.qos, publish.retain) == ("drone1/sensor1/temperature", 1, False)
    client.on_published("fog", publish.ref, 0, 0)
    for activator in (1, 1, 2):
        lease = DroneLease(activator_session=activator, drone_session=UAV_SESSION, nonce=1, bound=True)
        client.on_message("fog", Inbound("drone1/init_connect", encode(lease), 1), 100)
    assert [e.topic for e in client.tick(100) if isinstance(e, Publish)].count(publish.topic) == 1
    ack = Inbound("drone1/sensor_ack", encode(ReadingAck(readings=(reading(0).key,))), 1)
    assert ForgetReadings((reading(0).key,)) in client.on_message("fog", ack, 100)
    assert client.on_disconnected("fog", 200) == []
    assert not [e for e in client.tick(90_000) if isinstance(e, Publish)]


def test_a_uav_client_that_carries_nothing_knows_no_acknowledgements() -> None:
    client = UavClient(1, UAV_SESSION, Settings())
    assert "drone1/sensor_ack" not in [f for e in client.on_connected("fog", 0) for f in getattr(e, "filters", ())]
    (log,) = client.on_message("fog", Inbound("drone1/sensor_ack", encode(ReadingAck(readings=())), 1), 0)
    assert isinstance(log, Log)


STEPS = {
    "measure": 3,
    "measure again": 1,
    "work": 4,
    "to_the_activator": 3,
    "to_the_station": 3,
    "back_to_the_drone": 2,
    "connect": 3,
    "cut": 1,
    "lose_the_cloud": 1,
    "restart_drone": 1,
    "restart activator": 1,
    "later": 1,
}
"""What may happen, and how often beside the others."""


@examples(60)
@given(
    steps=st.lists(st.sampled_from([step for step, often in STEPS.items() for _ in range(often)]), min_size=30),
    limit=st.integers(1, 60),
    most=st.sampled_from([1, 2, 1000]),
)
def test_whatever_breaks_each_stored_reading_arrives_exactly_once(
    steps: list[str], limit: int, most: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    way = Way(tmp_path_factory.mktemp("way") / "sensors", limit)
    measured = 0
    for step in steps:
        if step == "measure":
            way.measure(measured, measured + 1, measured + 2)
            measured += 3
        elif step == "measure again":
            way.measure(*range(measured))
        elif step == "restart activator":
            way.restart_activator()
            way.carrier.on_new_activator(way.now_ms)
        elif step == "later":
            way.pass_time(3000)
        elif step.startswith(("to_", "back_")):
            getattr(way, step)(most)
        else:
            getattr(way, step)()
    way.settle()
    heard = [r.seq for r in way.heard]
    assert len(heard) == len(set(heard))
    assert way.stored <= set(heard)
    assert [(r.value, r.time_ms) for r in way.heard] == [
        (sent.value, sent.time_ms) for sent in (reading(seq).message for seq in heard)
    ]
    assert way.store is not None
    assert len(way.store) == 0
    way.store.close()
