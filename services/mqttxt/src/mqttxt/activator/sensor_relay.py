"""Relays readings to the cloud, outside the gate, and their acknowledgements to the drone."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.effects import Effect, Inbound, Publish
from ..protocol.codec import decode, encode
from ..protocol.readings import MOST_ACKNOWLEDGED, ReadingAck, ReadingKey, ReadingMessage, checked
from ..protocol.topics import DroneTopic
from ..security.cose import Envelope
from .drones import CLOUD, FOG
from .part import Part, Site

MOST_WAITING = 100
"""How many of a drone's readings are remembered, and await the cloud broker's PUBACK; more than it has in flight."""


@dataclass(frozen=True)
class Carried:
    """A reading that the cloud broker has not acknowledged yet."""

    drone: int
    key: ReadingKey


class SensorRelay(Part):
    """Relays readings and keeps none: until it is acknowledged, a reading stays on the drone (R9.14, R12.19).

    A reading is acknowledged when the cloud broker has, while a station is registered. The PUBACK alone is not enough:
    a broker may omit that no client subscribes (MQTT 5.0, 3.4.2.1), but a registered station has subscribed. Where
    messages are signed, no broker is trusted: a station's own acknowledgement is passed on, if it names a waiting
    reading.
    """

    def __init__(self, site: Site) -> None:
        super().__init__(site)
        self._on_the_way: dict[int, dict[ReadingKey, bool]] = {}
        """By drone: whether a station was registered when the reading was sent."""
        self._safe: dict[int, list[ReadingKey]] = {}
        self._waiting: dict[int, dict[ReadingKey, None]] = {}

    def on_reading(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """`droneY/sensorS/K`; raises PayloadError."""
        opened = self._to_fog.opened_reading(message.payload, topic.sensor, topic.name)
        reading = checked(topic.sensor, topic.name, decode(ReadingMessage, opened))
        self._wait(topic.drone, reading.key)
        on_the_way = self._on_the_way.setdefault(topic.drone, {})
        if reading.key in on_the_way or len(on_the_way) >= MOST_WAITING:
            return []
        on_the_way[reading.key] = bool(self._leases)
        to = self._cloud.drone_sensor(topic.drone, reading.sensor, reading.kind)
        is_signed = self._to_fog.signs_readings
        said = message.payload if is_signed else encode(reading.message, self._to_fog.settings.encoding)
        return [Publish(CLOUD, to, said, qos=1, ref=Carried(topic.drone, reading.key))]

    def on_published(self, carried: Carried, code: int, now_ms: int) -> list[Effect]:
        """The cloud broker's PUBACK; without a registered station the drone keeps the reading."""
        had_station = self._on_the_way.get(carried.drone, {}).pop(carried.key, False)
        if code == 0 and had_station and self._leases and self._to_fog.seal is None:
            self._safe.setdefault(carried.drone, []).append(carried.key)
        return []

    def on_heard(self, drone: int, ack: ReadingAck, envelope: Envelope) -> list[Effect]:
        """`fogX/droneY/sensor_ack`: a station's acknowledgement of readings, in the envelope for the drone."""
        waiting = self._waiting.get(drone, {})
        named = [key for key in ack.readings if key in waiting]
        for key in named:
            del waiting[key]
        return [Publish(FOG, self._fog.sensor_ack(drone), envelope.encode(), qos=1)] if named else []

    def _wait(self, drone: int, key: ReadingKey) -> None:
        waiting = self._waiting.setdefault(drone, {})
        waiting[key] = None
        while len(waiting) > MOST_WAITING:
            del waiting[next(iter(waiting))]

    def on_cloud_down(self) -> None:
        """Forget readings in flight: they may not have arrived, and the drone sends them again."""
        self._on_the_way.clear()

    def tick(self, now_ms: int) -> list[Effect]:
        """Send the acknowledgements of one tick in as few messages as possible."""
        if not self._safe:
            return []
        safe, self._safe = self._safe, {}
        out: list[Effect] = []
        for drone, keys in safe.items():
            for start in range(0, len(keys), MOST_ACKNOWLEDGED):
                ack = ReadingAck(readings=tuple(keys[start : start + MOST_ACKNOWLEDGED]))
                out.append(self._to_fog.publish(self._fog.sensor_ack(drone), ack, qos=1))
        return out
