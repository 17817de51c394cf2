"""The series that sensors measured and drones carried: the arrived values, checked against each sensor's own record."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mqttxt.protocol.readings import UNITS

from .fleet import Reading

VERSION = 1
KINDS = tuple(UNITS)
"""The kinds of series; each drone's sensor measures one of each."""


@dataclass(frozen=True)
class ReadingSeries:
    """One kind of value of one sensor, carried by its drone.

    samples    how many values are expected
    measured   how many the sensor recorded
    delivered  how many of those arrived with the recorded value, unit and time
    wrong      values that arrived with differences, or without a record of the sensor
    """

    drone: int
    sensor: int
    kind: str
    unit: str
    samples: int
    measured: int
    delivered: int
    wrong: int

    @property
    def is_whole(self) -> bool:
        return self.measured == self.delivered == self.samples and self.wrong == 0

    def to_data(self) -> dict[str, Any]:
        """The series as in series.json."""
        return asdict(self) | {"whole": self.is_whole}

    def __str__(self) -> str:
        what = f"sensor {self.sensor} {self.kind}: {self.delivered} of {self.samples} values as measured"
        return what + (f", {self.wrong} wrong" if self.wrong else "")


def read_measured(folder: Path, drones: Iterable[int]) -> Iterator[Reading]:
    """The readings that the drones' sensors recorded in sensorY.jsonl; none for a sensor without a file."""
    for drone in drones:
        path = folder / f"sensor{drone}.jsonl"
        for line in path.read_text(encoding="ascii").splitlines() if path.exists() else ():
            event = json.loads(line)
            if event.pop("event") == "reading":
                yield Reading(drone=drone, **event)


def has_measured(folder: Path, drone: int) -> bool:
    """Whether a drone's sensor recorded any reading: it begins when its drone first reaches it."""
    return any(True for _ in read_measured(folder, (drone,)))


def compare(
    drones: Iterable[int], measured: Iterable[Reading], arrived: Iterable[Reading], samples: int
) -> tuple[ReadingSeries, ...]:
    """Every series of the drones, even if none of its values arrived. A drone's sensor has the drone's number."""
    by_sensor, by_station = set(measured), set(arrived)
    written, right = Counter(map(_key, by_sensor)), Counter(map(_key, by_sensor & by_station))
    wrong = Counter(map(_key, by_station - by_sensor))
    keys = [(drone, drone, kind) for drone in drones for kind in KINDS]
    return tuple(ReadingSeries(*key, UNITS[key[2]], samples, written[key], right[key], wrong[key]) for key in keys)


def write(series: Iterable[ReadingSeries], path: Path) -> None:
    """Write series.json: each series, and whether it is whole."""
    rows = [one.to_data() for one in series]
    path.write_text(json.dumps({"version": VERSION, "series": rows}, indent=1) + "\n", encoding="ascii")


def _key(reading: Reading) -> tuple[int, int, str]:
    return reading.drone, reading.sensor, reading.kind
