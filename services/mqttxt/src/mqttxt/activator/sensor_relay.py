"""Readings through the activator: to the cloud outside of the gate, and back to the drone that they are safe."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.channel import Channel
from ..core.effects import Effect, Inbound, Publish
from ..protocol.codec import decode, encode
from ..protocol.readings import MOST_ACKNOWLEDGED, ReadingAck, ReadingKey, ReadingMessage, checked
from ..protocol.topics import CloudSide, DroneTopic, FogSide
from ..security.cose import Envelope
from .drones import CLOUD, FOG
from .leases import Leases

MOST_WAITING = 100
"""Readings of a drone, the newest: more than it has under way."""


@dataclass(frozen=True)
class Carried:
    """A reading on its way to the cloud broker."""

    drone: int
    key: ReadingKey


class SensorRelay:
    """Keeps nothing: what the cloud broker has not taken, for a station that is registered, stays on the drone.

    A broker may leave out that nobody subscribes (MQTT 5.0, 3.4.2.1), so its PUBACK alone does not say that somebody
    is there. Who registers has subscribed before. Where messages are signed no broker is believed: a station's own
    acknowledgement is passed on, where it names a reading that waits for one.
    """

    def __init__(self, to_fog: Channel, cloud: CloudSide, fog_side: FogSide, leases: Leases) -> None:
        self._to_fog = to_fog
        self._cloud = cloud
        self._fog = fog_side
        self._leases = leases
        self._on_the_way: dict[Carried, bool] = {}
        """Whether a station was registered when it left."""
        self._safe: dict[int, list[ReadingKey]] = {}
        self._waiting: dict[int, dict[ReadingKey, None]] = {}

    def on_reading(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """`droneY/sensorS/K`; raises PayloadError."""
        opened = self._to_fog.opened_reading(message.payload, topic.sensor, topic.name)
        reading = checked(topic.sensor, topic.name, decode(ReadingMessage, opened))
        self._wait(topic.drone, reading.key)
        carried = Carried(topic.drone, reading.key)
        if carried in self._on_the_way:
            return []
        self._on_the_way[carried] = bool(self._leases)
        to = self._cloud.drone_sensor(topic.drone, reading.sensor, reading.kind)
        is_signed = self._to_fog.signs_readings
        said = message.payload if is_signed else encode(reading.message, self._to_fog.settings.encoding)
        return [Publish(CLOUD, to, said, qos=1, ref=carried)]

    def on_published(self, carried: Carried, code: int, now_ms: int) -> list[Effect]:
        """The cloud broker's PUBACK; where nobody was there to get it the drone keeps the reading."""
        had_station = self._on_the_way.pop(carried, False)
        if code == 0 and had_station and self._leases and self._to_fog.seal is None:
            self._safe.setdefault(carried.drone, []).append(carried.key)
        return []

    def on_heard(self, drone: int, ack: ReadingAck, envelope: Envelope) -> list[Effect]:
        """`fogX/droneY/sensor_ack`: a station has heard readings, in an envelope that is the drone's to open."""
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
        """What was on its way may not have arrived; the drone sends it again."""
        self._on_the_way.clear()

    def tick(self, now_ms: int) -> list[Effect]:
        """The acknowledgements of one tick in as few messages as they fit in."""
        if not self._safe:
            return []
        safe, self._safe = self._safe, {}
        out: list[Effect] = []
        for drone, keys in safe.items():
            for start in range(0, len(keys), MOST_ACKNOWLEDGED):
                ack = ReadingAck(readings=tuple(keys[start : start + MOST_ACKNOWLEDGED]))
                out.append(self._to_fog.publish(self._fog.sensor_ack(drone), ack, qos=1))
        return out
