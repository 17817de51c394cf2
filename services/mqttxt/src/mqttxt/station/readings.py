"""Readings at the ground station: each is reported once, however often it was sent."""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict

from ..protocol.readings import Reading
from .outcomes import SensorReading

MOST_SENSORS = 10_000
MOST_RANGES = 1000
"""Gaps remembered in the numbers of a sensor's boot: far more than a drone's window can leave under way."""


class SeenNumbers:
    """The received numbers of one sensor's boot, as ranges: few, because numbers mostly arrive in order."""

    def __init__(self) -> None:
        self._ranges: list[list[int]] = []

    def add(self, seq: int) -> bool:
        """Note a number; returns whether it is new."""
        ranges = self._ranges
        at = bisect_right(ranges, seq, key=lambda pair: pair[0])
        before = ranges[at - 1] if at > 0 else None
        if before is not None and seq <= before[1]:
            return False
        after = ranges[at] if at < len(ranges) else None
        joins_before = before is not None and before[1] == seq - 1
        joins_after = after is not None and after[0] == seq + 1
        if joins_before and joins_after:
            assert before is not None
            assert after is not None
            before[1] = after[1]
            del ranges[at]
        elif joins_before:
            assert before is not None
            before[1] = seq
        elif joins_after:
            assert after is not None
            after[0] = seq
        else:
            ranges.insert(at, [seq, seq])
        if len(ranges) > MOST_RANGES:
            ranges[0][1] = ranges[1][1]
            del ranges[1]
        return True


class Readings:
    """The readings received from all sensors, and the newest of each kind.

    A drone's number is unique in a fleet, so a reading keeps its key when its drone changes the fog. Where sensors
    sign, a sensor's is unique too (`by_sensor`), and a reading that is replayed as another drone's is still the same.
    """

    def __init__(self, by_sensor: bool = False) -> None:
        self._by_sensor = by_sensor
        self.latest: OrderedDict[tuple[int, int, str], SensorReading] = OrderedDict()
        """By (drone, sensor, kind)."""
        self._seen: OrderedDict[tuple[int, int, int], SeenNumbers] = OrderedDict()

    def on_reading(self, fog: int, drone: int, reading: Reading) -> list[SensorReading]:
        """The reading as an event, unless it was received before."""
        message = reading.message
        source = (0 if self._by_sensor else drone, reading.sensor, message.boot)
        seen = self._seen.setdefault(source, SeenNumbers())
        self._seen.move_to_end(source)
        if len(self._seen) > MOST_SENSORS:
            self._seen.popitem(last=False)
        if not seen.add(message.seq):
            return []
        event = SensorReading(
            fog,
            drone,
            reading.sensor,
            message.boot,
            message.seq,
            reading.kind,
            message.value,
            reading.unit,
            message.time_ms,
        )
        self._keep(event)
        return [event]

    def _keep(self, event: SensorReading) -> None:
        key = (event.drone, event.sensor, event.kind)
        known = self.latest.get(key)
        if known is None or event.time_ms >= known.time_ms:
            self.latest[key] = event
        if len(self.latest) > MOST_SENSORS:
            self.latest.popitem(last=False)
