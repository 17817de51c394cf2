"""What sensors measured: every series held to its sensor's own record, delays, and frames that found nobody near."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from testbed.errors import ResultsError
from testbed.fly.observations import verdict_of
from testbed.fly.results import Attempt, Series, new_series
from testbed.numbers.metrics import measure_series
from testbed.numbers.metrics.attempt import measure_attempt
from testbed.numbers.packets import load
from tests.handmade.attempts import SECOND, T0, write_lines
from tests.handmade.attempts import make_attempt as make_plain
from tests.handmade.sensor_attempts import (
    CONNACK,
    CONNECT,
    FROM_DRONE,
    FROM_SENSOR,
    HUMIDITY,
    LIGHT,
    MEASURED_MS,
    MS,
    PINGREQ,
    PINGRESP,
    PUBACK,
    SUBACK,
    SUBSCRIBE,
    TEMPERATURE,
    Wire,
    from_fog,
    make_attempt,
)

KINDS = ("temperature", "humidity", "light")


@pytest.fixture
def series(tmp_path: Path) -> Series:
    return new_series(tmp_path, "scenario-4", "thesis", "ideal")


def carried(kinds: tuple[str, ...] = ("temperature", "humidity")) -> Wire:
    """The way of a reading from hop to hop, 1 ms each, each PUBLISH with its PUBACK; the connections before it."""
    wire = Wire()
    wire.send(T0 + SECOND, "uav1", "fog1", CONNECT)
    wire.send(T0 + SECOND + MS, "fog1", "uav1", CONNACK)
    wire.send(T0 + SECOND, "gs", "cloud", SUBSCRIBE)
    wire.send(T0 + SECOND + MS, "cloud", "gs", SUBACK)
    at = T0 + 2 * SECOND
    wire.send(at, "sensor1", "uav1", FROM_SENSOR)
    wire.send(at + MS, "uav1", "sensor1", PUBACK)
    for number, kind in enumerate(kinds):
        begun = at + (1 + number) * MS
        for place, (source, destination) in enumerate((("uav1", "fog1"), ("fog1", "cloud"), ("cloud", "gs"))):
            body = FROM_DRONE[kind] if source == "uav1" else from_fog(kind)
            wire.send(begun + place * MS, source, destination, body)
            wire.send(begun + (place + 1) * MS, destination, source, PUBACK)
    wire.send(T0 + 3 * SECOND, "uav1", "fog1", PINGREQ)
    wire.send(T0 + 3 * SECOND + MS, "fog1", "uav1", PINGRESP)
    wire.send(T0 + 3 * SECOND + 2 * MS, "uav1", "fog1", b"")
    return wire


def told(reading: dict[str, Any], after_ms: int, **changed: Any) -> dict[str, Any]:
    t_ns = (MEASURED_MS + after_ms) * MS
    return {"t_ns": t_ns, "event": "reading", "fog": 1, "drone": 1, **reading} | changed


def entry_of(attempt: Attempt) -> dict[str, Any]:
    manifest = attempt.manifest()
    return measure_attempt(attempt, manifest, verdict_of(attempt, manifest))


def test_every_series_that_there_should_be_is_held_to_its_sensors_own_record(series: Series) -> None:
    events = [told(TEMPERATURE, 7), told(HUMIDITY, 8)]
    attempt = make_attempt(series, carried(), events, {1: [TEMPERATURE, HUMIDITY, LIGHT], 2: []})
    entry = entry_of(attempt)
    found = [(s["drone"], s["kind"], s["unit"], s["measured"], s["delivered"], s["whole"]) for s in entry["series"]]
    assert found == [
        *((1, "temperature", "degC", 1, 1, True), (1, "humidity", "%", 1, 1, True), (1, "light", "lx", 1, 0, False)),
        *((2, kind, unit, 0, 0, False) for kind, unit in zip(KINDS, ("degC", "%", "lx"), strict=True)),
    ]


def test_a_reading_is_followed_from_its_sensor_to_the_ground_station(series: Series) -> None:
    """Three hops of 1 ms behind the sensor's, and half of one to leave the last link."""
    attempt = make_attempt(series, carried(), [told(TEMPERATURE, 7)], {1: [TEMPERATURE, HUMIDITY]})
    temperature, humidity, _ = entry_of(attempt)["series"][:3]
    assert temperature["delay_ms"]["max"] == 3.5
    assert humidity["delay_ms"]["max"] == 4.5, "it came by, though no program said that it had it"
    assert (temperature["delay_app_ms"]["max"], humidity["delay_app_ms"]["n"]) == (7.0, 0)
    assert entry_of(attempt)["reading_delay_ms"]["captures"]["n"] == 2


@pytest.mark.parametrize("changed", [{"value": 16.7}, {"unit": "%"}, {"time_ms": MEASURED_MS + 1}, {"boot": 1}])
def test_what_arrives_otherwise_than_it_was_measured_is_wrong(series: Series, changed: dict[str, Any]) -> None:
    events = [told(TEMPERATURE, 7, **changed), told(TEMPERATURE, 8, **changed)]
    attempt = make_attempt(series, carried(), events, {1: [TEMPERATURE]})
    first = entry_of(attempt)["series"][0]
    assert (first["delivered"], first["wrong"], first["whole"]) == (0, 1, False)


def test_a_series_that_measured_less_than_it_was_to_is_not_whole(series: Series) -> None:
    attempt = make_attempt(series, carried(), [told(TEMPERATURE, 7)], {1: [TEMPERATURE]}, samples=2)
    first = entry_of(attempt)["series"][0]
    assert (first["samples"], first["measured"], first["delivered"], first["whole"]) == (2, 1, 1, False)


def test_a_sensors_record_that_is_damaged_makes_the_attempt_void_with_the_file(series: Series) -> None:
    attempt = make_attempt(series, carried(), [], {1: [{"sensor": 1}]})
    with pytest.raises(ResultsError, match=r"sensor1\.jsonl: a reading without boot"):
        entry_of(attempt)


def test_metrics_with_sensors_keep_their_schema(series: Series) -> None:
    ended = {"status": "failed", "reason": "collect: not done within 90 s"}
    make_attempt(series, carried(), [told(TEMPERATURE, 7)], {1: [TEMPERATURE]}, **ended)
    (attempt,) = measure_series(series)["protocols"]["mavlink"]["attempts"]
    assert len(attempt["series"]) == 6


def test_plain_brokers_are_counted_as_sensors_data_its_acknowledgement_and_upkeep(series: Series) -> None:
    """The bytes are Mosquitto's own: bridges put names before topics and use QoS 1."""
    attempt = make_attempt(series, carried(), [], {1: [TEMPERATURE, HUMIDITY]})
    messages = load(attempt).messages
    told = {(row["kind"], row["purpose"]) for row in messages.select("kind", "purpose").to_dicts()}
    assert told == {
        *(("publish", "sensor"), ("puback", "acknowledgement")),
        *((kind, "upkeep") for kind in ("connect", "connack", "subscribe", "suback", "pingreq", "pingresp")),
    }
    topics = messages["topic"].drop_nulls().unique().to_list()
    assert {topic.count("/") for topic in topics} == {1, 2, 3}, "from sensor, drone and fog"
    entry = entry_of(attempt)
    assert entry["purposes"]["sensor"]["packets"] == 7
    assert entry["purposes"]["acknowledgement"]["packets"] == 8, "seven PUBACKs, and one of TCP alone"
    assert entry["purposes"]["upkeep"]["packets"] == 6
    assert set(entry["purposes"]) == {"sensor", "acknowledgement", "upkeep"}


def test_what_carrying_readings_took_is_told_by_kind_of_link(series: Series) -> None:
    entry = entry_of(make_attempt(series, carried(), [], {1: [TEMPERATURE, HUMIDITY]}))
    counts = {
        link: {purpose: count["packets"] for purpose, count in by.items()}
        for link, by in entry["reading_traffic"].items()
    }
    assert counts == {
        "sense": {"sensor": 1, "acknowledgement": 1},
        "air": {"sensor": 2, "acknowledgement": 3, "upkeep": 4},
        "backhaul": {"sensor": 2, "acknowledgement": 2},
        "wan": {"sensor": 2, "acknowledgement": 2, "upkeep": 2},
    }
    bytes_of = sum(by.get("sensor", {"bytes": 0})["bytes"] for by in entry["reading_traffic"].values())
    assert bytes_of == entry["purposes"]["sensor"]["bytes"]
    assert entry["message_sizes"]["reading"]["n"] == 9, "three of them share a frame"


def test_what_a_sensor_sends_while_its_drone_is_far_is_lost_but_told_apart(series: Series) -> None:
    wire = carried()
    wire.send(T0 + SECOND // 2, "sensor1", "uav1", b"", arrives=False)
    wire.send(T0 + 5 * SECOND, "sensor1", "uav1", b"", arrives=False)
    attempt = make_attempt(series, wire, [], {1: [TEMPERATURE]})
    link = {"link": "sense:uav1:up", "cause": "range"}
    changes = [
        {"t_ns": T0 - SECOND, **link, "change": {"closed": True}},
        {"t_ns": T0 + SECOND, **link, "change": {}},
        {"t_ns": T0 + 4 * SECOND, "link": "sense:uav1:up", "cause": "by hand", "change": {"closed": True}},
    ]
    write_lines(attempt.path / "links" / "events.jsonl", changes)
    entry = entry_of(attempt)
    assert entry["links"]["sense:uav1:up"]["lost"] == 2
    assert entry["out_of_range"] == 1, "the other one was lost while the drone was near"


def test_an_attempt_without_sensors_says_nothing_of_them(series: Series) -> None:

    entry = entry_of(make_plain(series))
    assert (entry["series"], entry["reading_delay_ms"], entry["out_of_range"]) == ([], None, 0)
