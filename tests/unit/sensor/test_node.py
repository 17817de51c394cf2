"""A sensor node keeps each reading until the drone says that it is stored, and says what it gave up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from mqttxt.core.effects import Inbound, Log, Publish, Subscribe
from mqttxt.core.settings import Settings
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.readings import ReadingAck, ReadingKey, ReadingMessage
from sensor.node import WINDOW, Dropped, Finished, Measured, SensorNode, SensorOptions

BOOT, NOON_MS = 0xB007, 1_767_268_800_000


class SensorBench:
    """A node whose broker and drone are this test."""

    def __init__(self, connected: bool = True, **options: Any) -> None:
        self.now_ms = 0
        fields = {"kinds": ("temperature",), **options}
        self.node = SensorNode(BOOT, SensorOptions(**fields), Settings(), lambda: NOON_MS + self.now_ms)
        if connected:
            self.connect()

    def connect(self) -> list[Any]:
        (subscribe,) = self.node.on_connected("broker", self.now_ms)
        assert isinstance(subscribe, Subscribe)
        assert subscribe.filters == ("sensor_ack",)
        return self.node.on_subscribed(subscribe, self.now_ms)

    def tick(self, milliseconds: int = 0) -> list[Any]:
        self.now_ms += milliseconds
        return self.node.tick(self.now_ms)

    def pass_time(self, milliseconds: int) -> list[Any]:
        return [effect for _ in range(0, milliseconds, 50) for effect in self.tick(50)]

    def taken(self, *seqs: int) -> None:
        for seq in seqs:
            self.node.on_published("broker", key(seq), 0, self.now_ms)

    def acknowledge(self, *seqs: int) -> list[Any]:
        payload = encode(ReadingAck(readings=tuple(map(key, seqs))))
        return self.node.on_message("broker", Inbound("sensor_ack", payload, 1), self.now_ms)


def key(seq: int) -> ReadingKey:
    return ReadingKey(sensor=1, boot=BOOT, seq=seq)


def sent(effects: Iterable[Any]) -> list[int]:
    return [decode(ReadingMessage, e.payload).seq for e in effects if isinstance(e, Publish)]


def test_each_reading_has_its_topic_time_boot_and_number() -> None:
    bench = SensorBench(kinds=("temperature", "light"), number=4)
    published = [effect for effect in bench.tick() if isinstance(effect, Publish)]
    assert [(p.topic, p.qos, p.retain) for p in published] == [
        ("sensor4/temperature", 1, False),
        ("sensor4/light", 1, False),
    ]
    messages = [decode(ReadingMessage, p.payload) for p in published]
    assert [(m.boot, m.seq, m.time_ms, m.unit) for m in messages] == [
        (BOOT, 0, NOON_MS, None),
        (BOOT, 1, NOON_MS, None),
    ]


def test_it_measures_at_its_rate_and_a_late_tick_makes_up_for_what_was_due() -> None:
    bench = SensorBench(rate_hz=4)
    bench.tick()
    assert sent(bench.tick(249)) == []
    late = bench.tick(751)
    assert sent(late) == [1, 2, 3, 4]
    times = [effect.reading.message.time_ms - NOON_MS for effect in late if isinstance(effect, Measured)]
    assert times == [250, 500, 750, 1000]


def test_readings_that_were_made_without_a_broker_go_out_oldest_first_when_there_is_one() -> None:
    bench = SensorBench(connected=False)
    assert sent(bench.pass_time(3000)) == []
    assert sent(bench.connect()) == [0, 1, 2]


def test_what_was_not_acknowledged_goes_out_again_after_a_reconnection() -> None:
    bench = SensorBench(samples=3, rate_hz=100)
    bench.pass_time(100)
    bench.taken(0, 1, 2)
    bench.acknowledge(1)
    bench.node.on_disconnected("broker", bench.now_ms)
    assert sent(bench.connect()) == [0, 2]


def test_what_the_broker_took_and_the_drone_did_not_store_is_sent_again_later_and_later() -> None:
    bench = SensorBench(samples=1)
    bench.tick()
    bench.taken(0)
    times = [bench.now_ms for _ in range(640) if sent(bench.tick(50))]
    assert times == [2000, 6000, 14_000, 30_000]


def test_no_more_than_a_window_is_under_way_at_once() -> None:
    bench = SensorBench(samples=3 * WINDOW, rate_hz=1000)
    assert sent(bench.pass_time(1000)) == list(range(WINDOW))
    assert sent(bench.acknowledge(0, 1)) == [WINDOW, WINDOW + 1]


def test_when_too_many_are_kept_the_oldest_goes_and_that_is_said() -> None:
    bench = SensorBench(connected=False, keep=2, samples=4, rate_hz=100)
    out = bench.pass_time(100)
    assert [effect.reading.message.seq for effect in out if isinstance(effect, Dropped)] == [0, 1]
    assert [effect.kind for effect in out if isinstance(effect, Log)] == ["dropped", "dropped"]
    assert sent(bench.connect()) == [2, 3]


def test_it_ends_once_everything_is_stored() -> None:
    bench = SensorBench(samples=2, rate_hz=100)
    assert Finished() not in bench.pass_time(1000)
    bench.acknowledge(0)
    assert Finished() not in bench.tick(50)
    bench.acknowledge(1)
    assert Finished() in bench.tick(50)


def test_other_sensors_acknowledgements_and_malformed_ones_change_nothing() -> None:
    bench = SensorBench(samples=1)
    bench.tick()
    other = ReadingKey(sensor=2, boot=BOOT, seq=0)
    bench.node.on_message("broker", Inbound("sensor_ack", encode(ReadingAck(readings=(other,))), 1), 0)
    (log,) = bench.node.on_message("broker", Inbound("sensor_ack", b"\xff", 1), 0)
    assert isinstance(log, Log)
    assert Finished() not in bench.tick(50)


@given(st.lists(st.sampled_from(["tick", "cut", "connect", "take", "store"]), max_size=80), st.integers(1, 20))
def test_every_reading_is_stored_or_given_up_whatever_the_link_does(steps: list[str], keep: int) -> None:
    bench = SensorBench(rate_hz=20, keep=keep, samples=30)
    measured: list[int] = []
    dropped: list[int] = []
    on_link: list[int] = []
    stored: set[int] = set()

    def note(effects: list[Any]) -> None:
        measured.extend(e.reading.message.seq for e in effects if isinstance(e, Measured))
        dropped.extend(e.reading.message.seq for e in effects if isinstance(e, Dropped))
        on_link.extend(sent(effects))

    def store() -> None:
        arrived = [*on_link]
        on_link.clear()
        stored.update(arrived)
        note(bench.acknowledge(*arrived[:100]))

    up = True
    for step in [*steps, "cut", "connect"]:
        if step == "tick":
            note(bench.tick(100))
        elif step == "cut" and up:
            up = False
            on_link.clear()
            bench.node.on_disconnected("broker", bench.now_ms)
        elif step == "connect" and not up:
            up = True
            note(bench.connect())
        elif step == "take":
            bench.taken(*on_link)
        elif step == "store":
            store()
    for _ in range(60):
        note(bench.tick(100))
        store()
    assert measured == list(range(30))
    assert stored | set(dropped) == set(measured)
    assert Finished() in bench.tick(0)


def test_what_is_reached_later_is_measured_from_then_on() -> None:
    bench = SensorBench(connected=False, when_reached=True, samples=2)
    assert bench.pass_time(5000) == []
    bench.connect()
    first = [effect.reading.message for effect in bench.pass_time(3000) if isinstance(effect, Measured)]
    assert [message.time_ms - NOON_MS for message in first] == [5050, 6050]


def test_it_goes_on_measuring_when_the_connection_is_lost_after_that() -> None:
    bench = SensorBench(when_reached=True)
    bench.tick()
    bench.node.on_disconnected("broker", bench.now_ms)
    assert any(isinstance(effect, Measured) for effect in bench.pass_time(1500))


def test_one_that_stays_does_not_end_with_its_last_reading() -> None:
    for stays in (True, False):
        bench = SensorBench(samples=1, stays=stays)
        bench.tick()
        bench.acknowledge(0)
        assert any(isinstance(effect, Finished) for effect in bench.tick(50)) is not stays


def plain_bench(**options: Any) -> SensorBench:
    bench = SensorBench(connected=False, plain=True, **options)
    bench.node.on_connected("broker", 0)
    return bench


def test_a_plain_brokers_puback_is_all_that_a_reading_waits_for() -> None:
    bench = plain_bench(samples=1)
    assert sent(bench.tick()) == [0]
    bench.taken(0)
    assert bench.tick(60_000) == [Finished()]


def test_nothing_is_subscribed_to_at_a_plain_broker() -> None:
    bench = SensorBench(connected=False, plain=True)
    bench.tick()
    published = bench.node.on_connected("broker", 0)
    assert [effect.topic for effect in published if isinstance(effect, Publish)] == ["sensor1/temperature"]
    assert len(published) == 1


def test_what_a_plain_broker_refuses_is_offered_again() -> None:
    bench = plain_bench(samples=1)
    bench.tick()
    bench.node.on_published("broker", key(0), 0x97, bench.now_ms)
    assert sent(bench.pass_time(60_000))[:1] == [0]


def test_a_plain_brokers_window_moves_on() -> None:
    bench = plain_bench(rate_hz=1000.0)
    bench.tick()
    bench.tick(2 * WINDOW)
    more = bench.node.on_published("broker", key(0), 0, bench.now_ms)
    assert sent(more) == [WINDOW]
