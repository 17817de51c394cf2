"""Recent readings and PSMI lists, for charts and tables."""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, field
from typing import Any

from ..station.outcomes import Event, PsmiList, SensorReading
from .event_log import as_plain

MOST_POINTS = 300
MOST_CHARTS = 500
MOST_LISTS = 5

ChartKey = tuple[str, int, int, str]
"""The fleet's name (empty for a single fleet), the drone's and the sensor's number, and the kind of reading."""


@dataclass
class Chart:
    """The newest readings of one kind of one sensor; `total` counts all that arrived."""

    unit: str
    points: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=MOST_POINTS))
    total: int = 0


class History:
    """The newest readings of each sensor, and the newest lists of PSMI."""

    def __init__(self) -> None:
        self.charts: OrderedDict[ChartKey, Chart] = OrderedDict()
        self.lists: deque[PsmiList] = deque(maxlen=MOST_LISTS)

    def on_event(self, event: Event) -> None:
        """Keep a reading or a PSMI list."""
        if isinstance(event, SensorReading):
            self.on_reading(event)
        elif isinstance(event, PsmiList):
            self.lists.append(event)

    def on_reading(self, reading: SensorReading) -> None:
        """Keep a reading; beyond MOST_CHARTS the chart that has waited longest for a reading is dropped."""
        key = (reading.fleet, reading.drone, reading.sensor, reading.kind)
        chart = self.charts.setdefault(key, Chart(reading.unit))
        chart.points.append((reading.time_ms, reading.value))
        chart.total += 1
        self.charts.move_to_end(key)
        if len(self.charts) > MOST_CHARTS:
            self.charts.popitem(last=False)

    def readings_since(self, sent: dict[ChartKey, int]) -> list[dict[str, Any]]:
        """The points that a browser has not been sent, by chart; `sent` counts those sent, and is updated."""
        found = []
        for dropped in sent.keys() - self.charts.keys():
            del sent[dropped]
        for key, chart in self.charts.items():
            fresh = min(chart.total - sent.get(key, 0), len(chart.points))
            if fresh > 0:
                named = dict(zip(("fleet", "drone", "sensor", "kind"), key, strict=True))
                points = [chart.points[index] for index in range(-fresh, 0)]
                found.append({**named, "unit": chart.unit, "points": as_plain(points)})
                sent[key] = chart.total
        return found
