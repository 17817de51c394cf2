"""The values that sensors measured and those that reached the ground station: each value's way, and each series."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import polars as pl

from mqttxt.errors import PayloadError
from mqttxt.protocol.codec import decode
from mqttxt.protocol.readings import UNITS, ReadingMessage

from ...errors import ResultsError
from ...fly.results import Attempt, read_json_lines
from ..attempt_entry import AmountEntry, ReadingDelays, ReadingsEntry, ReadingsNumbers, Summary
from ..packets import Packets
from .delays import summary
from .shaping import Shaping
from .ways import STATION, Ways
from .window import Window

SENSE = "sense"
_FIELDS = ("sensor", "boot", "seq", "kind", "value", "unit", "time_ms")
_TOPIC = r"(^|/)sensor\d+/[^/]+$"
_OWN_PURPOSES = ("sensor", "acknowledgement", "upkeep")

Key = tuple[int, int, int, int]
"""The key of a reading: drone, sensor, the sensor's boot, and the sequence number in that boot."""


@dataclass(frozen=True)
class MeasuredValue:
    """A value in a sensor's record, and its way; the time of a step that did not happen is None.

    time_ms      when it was measured, since 1970
    left_ns      when its first frame left the sensor's node, by the captures
    arrived_ns   when the first copy reached the ground station's node, by the captures
    told_ns      when the ground station's program had it, with value, unit and time as measured
    """

    drone: int
    sensor: int
    kind: str
    unit: str
    value: float
    time_ms: int
    left_ns: int | None = None
    arrived_ns: int | None = None
    told_ns: int | None = None

    @property
    def delay_ms(self) -> float | None:
        """From the sensor's node to the ground station's, by the captures."""
        return _milliseconds(self.left_ns, self.arrived_ns)

    @property
    def delay_app_ms(self) -> float | None:
        """From the measurement until the ground station's program had the value."""
        return _milliseconds(self.time_ms * 1_000_000, self.told_ns)


@dataclass(frozen=True)
class Readings:
    """All values in the order of measurement, and how many arrived changed, by (drone, sensor, kind)."""

    measured: tuple[MeasuredValue, ...]
    wrong: Counter[tuple[int, int, str]]


def measure(
    attempt: Attempt, manifest: dict[str, Any], packets: Packets | None, window: Window | None, shaping: Shaping
) -> ReadingsNumbers:
    """Measure the readings for `metrics.json`: series, delays, the frames that carried them, and the frames lost at a
    closed sensor link. Raises ResultsError if a sensor's record cannot be read.
    """
    found: ReadingsNumbers = {"series": [], "reading_delay_ms": None, "reading_traffic": {}, "out_of_range": 0}
    if (readings := readings_of(attempt, packets)) is not None:
        samples = int(manifest["configuration"].get("SAMPLES") or 0)
        found["series"] = series_of(readings, sensors_of(attempt), samples)
        found["reading_delay_ms"] = delays_ms(readings)
        if packets is not None and window is not None:
            found["reading_traffic"] = carried(packets, window)
            found["out_of_range"] = out_of_range(packets, window, shaping.events)
    return found


def readings_of(attempt: Attempt, packets: Packets | None) -> Readings | None:
    """Follow each reading; None for an attempt without sensors. Raises ResultsError if a record cannot be read."""
    sensors = sensors_of(attempt)
    if not sensors:
        return None
    left, arrived = _on_links(packets, Ways(attempt.topology())) if packets is not None else ({}, {})
    written = {key: reading for drone in sensors for key, reading in _written(attempt, drone)}
    told: dict[Key, int] = {}
    wrong: dict[tuple[Any, ...], tuple[int, int, str]] = {}
    for event in attempt.events():
        if event["event"] == "reading":
            key, values = _key(event["drone"], event), tuple(event.get(field) for field in _FIELDS)
            if key in written and values == tuple(written[key][field] for field in _FIELDS):
                told.setdefault(key, int(event["t_ns"]))
            else:
                wrong[event["drone"], *values] = (event["drone"], event["sensor"], str(event["kind"]))
    found = [
        MeasuredValue(
            drone=key[0],
            sensor=key[1],
            kind=str(reading["kind"]),
            unit=str(reading["unit"]),
            value=float(reading["value"]),
            time_ms=int(reading["time_ms"]),
            left_ns=left.get(key),
            arrived_ns=arrived.get(key),
            told_ns=told.get(key),
        )
        for key, reading in written.items()
    ]
    return Readings(tuple(sorted(found, key=lambda one: (one.time_ms, one.drone))), Counter(wrong.values()))


def sensors_of(attempt: Attempt) -> list[int]:
    """The drones that have a sensor (of the same number), by the links to sensors; empty in experiments without."""
    links = [link.name.split(":") for link in attempt.topology().links]
    return sorted(int(name.removeprefix("uav")) for kind, name in links if kind == SENSE)


def series_of(readings: Readings, drones: list[int], samples: int) -> list[ReadingsEntry]:
    """An entry for each expected series, even if none of its values was measured."""
    by_series: dict[tuple[int, int, str], list[MeasuredValue]] = {
        (drone, drone, kind): [] for drone in drones for kind in UNITS
    }
    for one in readings.measured:
        by_series.setdefault((one.drone, one.sensor, one.kind), []).append(one)
    return [_series(key, own, readings.wrong[key], samples) for key, own in by_series.items()]


def delays_ms(readings: Readings) -> ReadingDelays:
    """The delays over all series: `captures` from node to node, `app` from the measurement to the program."""
    return {
        "captures": _summary(readings.measured, lambda one: one.delay_ms),
        "app": _summary(readings.measured, lambda one: one.delay_app_ms),
    }


def name_readings(messages: pl.DataFrame) -> pl.DataFrame:
    """The rows of readings in the messages table, each named `reading`."""
    rows = messages.with_row_index("row").filter(_is_reading()).select(pl.col("row").cast(pl.Int64))
    return rows.with_columns(pl.lit("reading").alias("name"))


def carried(packets: Packets, window: Window) -> dict[str, dict[str, AmountEntry]]:
    """MQTT's frames in the window by class of link and purpose: readings, acknowledgements, upkeep of connections.

    A frame counts for its first message. Beside MAVLink all of them serve the sensors. Over MQTT-XT the last two
    purposes serve all other messages too, except on the sensors' links.
    """
    found: dict[str, dict[str, AmountEntry]] = {}
    counts = (
        packets.frames.filter(window.entered, pl.col("protocol").cast(pl.String).is_in(["mqtt", "mqttsn"]))
        .with_columns(pl.col("link").cast(pl.String).str.split(":").list.first(), pl.col("purpose").cast(pl.String))
        .filter(pl.col("purpose").is_in(_OWN_PURPOSES))
        .group_by("link", "purpose")
        .agg(pl.len().alias("packets"), pl.col("size").sum().alias("bytes"))
    )
    for link, purpose, frames, size in counts.sort("link", "purpose").iter_rows():
        found.setdefault(link, {})[purpose] = {"packets": frames, "bytes": size}
    return found


def out_of_range(packets: Packets, window: Window, events: Iterable[Mapping[str, Any]]) -> int:
    """Count the frames of the window that were lost because a sensor's link was closed, its drone being too far away.

    `events` are the changes of links, sorted by time. A sensor tries to connect all the time, so its first frames are
    lost: they show when the drone came near, not how good the links are.
    """
    changes: dict[str, list[tuple[int, bool]]] = {}
    for event in events:
        if event.get("cause") == "range":
            closed = bool((event.get("change") or {}).get("closed"))
            changes.setdefault(str(event["link"]), []).append((int(event["t_ns"]), closed))
    lost = packets.frames.filter(window.entered, pl.col("lost")).select("t_ns", pl.col("link").cast(pl.String))
    count = 0
    for t_ns, link in lost.filter(pl.col("link").is_in(list(changes))).iter_rows():
        before = bisect_right(changes[link], (t_ns, True)) - 1
        count += before >= 0 and changes[link][before][1]
    return count


def _series(key: tuple[int, int, str], own: list[MeasuredValue], wrong: int, samples: int) -> ReadingsEntry:
    drone, sensor, kind = key
    delivered = sum(one.told_ns is not None for one in own)
    return {
        "drone": drone,
        "sensor": sensor,
        "kind": kind,
        "unit": own[0].unit if own else UNITS.get(kind, ""),
        "samples": samples,
        "measured": len(own),
        "delivered": delivered,
        "wrong": wrong,
        "whole": len(own) == delivered == samples and wrong == 0,
        "delay_ms": _summary(own, lambda one: one.delay_ms),
        "delay_app_ms": _summary(own, lambda one: one.delay_app_ms),
    }


def _summary(
    own: list[MeasuredValue] | tuple[MeasuredValue, ...], of: Callable[[MeasuredValue], float | None]
) -> Summary:
    return summary([delay for one in own if (delay := of(one)) is not None])


def _written(attempt: Attempt, drone: int) -> Iterator[tuple[Key, dict[str, Any]]]:
    """The readings in the record of a drone's sensor; none if the sensor was never in range."""
    path = attempt.path / "sensors" / f"sensor{drone}.jsonl"
    for line in read_json_lines(path, frozenset({"event"})):
        if line["event"] == "reading":
            if missing := [field for field in _FIELDS if field not in line]:
                raise ResultsError(f"{path}: a reading without {missing[0]}")
            yield _key(drone, line), line


def _key(drone: int, told: dict[str, Any]) -> Key:
    return drone, told["sensor"], told["boot"], told["seq"]


def _on_links(packets: Packets, ways: Ways) -> tuple[dict[Key, int], dict[Key, int]]:
    """When each reading's first frame left its sensor, and when its first copy reached the ground station."""
    link = pl.col("link").cast(pl.String)
    table = packets.messages.filter(_is_reading()).with_columns(
        link.str.extract(rf"^{SENSE}:uav(\d+):up$").cast(pl.Int64).alias("from"),
        pl.col("topic").str.extract(r"drone(\d+)/[^/]+/[^/]+$").cast(pl.Int64).alias("drone"),
        pl.col("topic").str.extract(r"sensor(\d+)/[^/]+$").cast(pl.Int64).alias("sensor"),
    )
    came = table.filter(link.is_in(ways.entering(STATION)), pl.col("left_ns").is_not_null())
    return _first_times(table, "from", "t_ns"), _first_times(came, "drone", "left_ns")


def _first_times(table: pl.DataFrame, drone: str, time: str) -> dict[Key, int]:
    """By reading the least value of the column `time`; rows without a drone and bodies that are no reading are left
    out."""
    found: dict[Key, int] = {}
    rows = table.filter(pl.col(drone).is_not_null()).sort(time).select(time, drone, "sensor", "body")
    for t_ns, of, sensor, body in rows.iter_rows():
        try:
            message = decode(ReadingMessage, body)
        except PayloadError:
            continue
        found.setdefault((of, sensor, message.boot, message.seq), t_ns)
    return found


def _is_reading() -> pl.Expr:
    """Whether a message is a PUBLISH of a reading, on any part of its way."""
    return (pl.col("body").is_not_null() & pl.col("topic").str.contains(_TOPIC)).fill_null(False)


def _milliseconds(start_ns: int | None, end_ns: int | None) -> float | None:
    return None if start_ns is None or end_ns is None else (end_ns - start_ns) / 1e6
