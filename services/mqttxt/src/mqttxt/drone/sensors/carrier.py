"""Carries sensors' readings on a drone: from its own broker into a store, and on to the fog (docs/protocol.md).

A reading is acknowledged to its sensor once it is stored, and leaves the store once the activator has acknowledged it.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass

from ...core.channel import Channel
from ...core.effects import Inbound, Log, Publish, Subscribe
from ...core.floods import TokenBucket
from ...core.settings import Retry
from ...errors import PayloadError
from ...protocol.codec import decode, encode
from ...protocol.readings import MOST_ACKNOWLEDGED, Reading, ReadingAck, ReadingKey, ReadingMessage, checked
from ...protocol.topics import REVOKED, FogSide, SensorSide
from ...security.cose import Envelope
from ...security.seal import EXPIRED
from ..effects import Acknowledge, Effect, ForgetReadings, LoadReadings, StoreReading

SENSORS = "sensors"
"""The connection to the drone's own broker."""
WINDOW = 32
"""Readings that may be under way to the activator at once: a stalled link holds no more of them."""
SENSOR_PER_S, SENSOR_AT_ONCE = 1000, 2000
"""Readings taken from one sensor, per second and at once. It keeps the others and sends them again."""


@dataclass
class UnderWay:
    """A reading under way. `retry` counts from the broker's PUBACK; before it the transport repeats.

    `again`: it was sent before, and its receivers may lack the sensor's certificate.
    """

    reading: Reading
    retry: Retry | None = None
    again: bool = False


class Carrier:
    """The sensors' side of a UAV client. Times are milliseconds of its session clock; `channel` is to the fog."""

    def __init__(self, drone: int, channel: Channel, fog_side: FogSide) -> None:
        self.side = SensorSide()
        self._drone = drone
        self._channel = channel
        self._to_sensors = Channel(SENSORS, "", channel.settings, channel.seal if channel.signs_readings else None)
        self._fog = fog_side
        self._under_way: dict[ReadingKey, UnderWay] = {}
        self._place = 0
        self._is_loading = False
        self._may_have_more = True
        self._fog_is_up = False
        self._budget = TokenBucket(SENSOR_PER_S, SENSOR_AT_ONCE)

    def on_connected(self, now_ms: int) -> list[Effect]:
        """Subscribe to readings on the drone's own broker."""
        return [Subscribe(SENSORS, (self.side.filter,), live_only=True)]

    def on_message(self, message: Inbound, now_ms: int) -> list[Effect]:
        """A message from the drone's own broker: a reading to store; others are counted and dropped."""
        if message.topic == REVOKED:  # this drone's own publication, which the filter of readings matches
            return _acknowledge(message)
        try:
            sensor, kind = self.side.parse(message.topic)
            if not self._budget.takes(sensor, now_ms):
                return [Log("flood", f"readings of sensor {sensor}: too many"), *_acknowledge(message)]
            payload = self._channel.opened_reading(message.payload, sensor, kind)
            said = _with_certificate(message.payload) if self._channel.signs_readings else b""
            reading = checked(sensor, kind, decode(ReadingMessage, payload), said)
        except PayloadError as error:
            kind = "sensor_topic" if error.kind == "topic" else "sensor_reading"
            return [Log(kind, f"{message.topic[:100]}: {error}"), *_acknowledge(message)]
        return [StoreReading(reading, message.receipt)]

    def on_stored(self, stored: Iterable[StoreReading], now_ms: int) -> list[Effect]:
        """Acknowledge readings that are on the disk: their sensors no longer need to keep them."""
        effects = [*stored]
        self._may_have_more = self._may_have_more or bool(effects)
        out: list[Effect] = [Acknowledge(SENSORS, e.receipt) for e in effects if e.receipt is not None]
        for start in range(0, len(effects), MOST_ACKNOWLEDGED):
            keys = tuple(e.reading.key for e in effects[start : start + MOST_ACKNOWLEDGED])
            ack = ReadingAck(readings=keys)
            out.append(self._to_sensors.publish(self.side.ack, ack, qos=1, with_certificate=True))
        return out + self._load()

    def on_refused(self, refused: Iterable[StoreReading], reason: str, now_ms: int) -> list[Effect]:
        """Log readings that could not be stored. They get no `sensor_ack`, so their sensors keep them."""
        out: list[Effect] = []
        for effect in refused:
            out.append(Log("sensor_store", f"{reason}; new readings stay with their sensors until there is room"))
            if effect.receipt is not None:
                out.append(Acknowledge(SENSORS, effect.receipt))
        return out

    def on_fog_up(self, now_ms: int) -> list[Effect]:
        """The birth is published: send again the readings that an earlier connection may have lost."""
        self._fog_is_up = True
        for sent in self._under_way.values():
            sent.retry = None
        return [*map(self._publish, self._under_way.values()), *self._load()]

    def on_path(self) -> list[Effect]:
        """Send again the readings without PUBACK, which may be lost with the earlier connection to the fog."""
        return [self._publish(sent) for sent in self._under_way.values() if sent.retry is None]

    def on_fog_down(self) -> None:
        self._fog_is_up = False

    def on_new_activator(self, now_ms: int) -> None:
        """The activator has a new session: repeat the readings that the old one may have lost."""
        for sent in self._under_way.values():
            if sent.retry is not None:
                sent.retry = Retry(now_ms)

    def on_loaded(self, rows: list[tuple[int, Reading]], most: int, now_ms: int) -> list[Effect]:
        """Send stored readings, each with its place: the result of a LoadReadings of `most`."""
        self._is_loading = False
        self._may_have_more = len(rows) >= most
        out: list[Effect] = []
        for place, reading in rows:
            self._place = max(self._place, place)
            if self._channel.signs_readings and not reading.said:
                out.append(
                    Log("unsigned_reading", f"{reading.key}: stays, because nobody takes it without a signature")
                )
                continue
            sent = self._under_way[reading.key] = UnderWay(reading)
            if self._fog_is_up:
                out.append(self._publish(sent))
        return out + self._load()

    def on_published(self, key: ReadingKey, code: int, now_ms: int) -> list[Effect]:
        """The fog's broker has the reading, but may lose it: wait for the activator's acknowledgement."""
        sent = self._under_way.get(key)
        if sent is not None and sent.retry is None:
            sent.retry = Retry.unanswered(now_ms)
        return []

    def on_ack(self, message: Inbound, now_ms: int) -> list[Effect]:
        """`droneY/sensor_ack`; raises PayloadError."""
        keys = decode(ReadingAck, self._acknowledged(message)).readings
        for key in keys:
            self._under_way.pop(key, None)
        return [ForgetReadings(keys), *self._load()]

    def tick(self, now_ms: int) -> list[Effect]:
        """Repeat readings that the activator has not acknowledged in time, and load more if there is room."""
        out: list[Effect] = []
        if self._fog_is_up:
            due = [f for f in self._under_way.values() if f.retry is not None and f.retry.is_due(now_ms)]
            out += [effect for sent in due for effect in self._again(sent)]
        return out + self._load()

    def _again(self, sent: UnderWay) -> list[Effect]:
        """Send a reading again, or drop it from the window if its sensor's certificate is no longer valid."""
        reading, sent.again = sent.reading, True
        refusal = self._refusal(reading)
        if refusal is None:
            return [self._publish(sent)]
        del self._under_way[reading.key]
        return [Log("sensor_certificate", f"{reading.key}: stays, because nobody would take it: {refusal}")]

    def _acknowledged(self, message: Inbound) -> bytes:
        """The acknowledging payload; where messages are signed, a station that received the readings signed it."""
        seal = self._channel.seal
        if seal is None:
            return message.payload
        topic = self._channel.signed_topic(message.topic)
        signed = seal.open_of_station(topic, Envelope.parse(message.payload)).before_its_end()
        if not signed.certificate.rights.may_hear:
            raise PayloadError(f"{signed.signer}: expected the right to hear readings", "not_allowed")
        return signed.payload

    def _refusal(self, reading: Reading) -> str | None:
        """Why a station that does not know the sensor would refuse its reading, if it would."""
        seal = self._channel.seal
        if seal is None or not seal.signs_readings:
            return None
        try:
            signed = seal.open(self.side.sensor(reading.sensor, reading.kind), reading.said, f"sensor{reading.sensor}")
        except PayloadError as error:
            return str(error)
        return EXPIRED if signed.is_expired else None

    def _load(self) -> list[Effect]:
        room = WINDOW - len(self._under_way)
        if not self._fog_is_up or self._is_loading or not self._may_have_more or room == 0:
            return []
        self._is_loading = True
        return [LoadReadings(self._place, room)]

    def _publish(self, sent: UnderWay) -> Publish:
        reading = sent.reading
        topic = self._fog.sensor(self._drone, reading.sensor, reading.kind)
        if not self._channel.signs_readings:
            payload = encode(reading.message, self._channel.settings.encoding)
        else:
            payload = reading.said if sent.again else Envelope.parse(reading.said).bare().encode()
        return Publish(self._channel.link, topic, payload, qos=1, ref=reading.key)


def is_carried(ref: Hashable) -> bool:
    """Whether a publish's `ref` belongs to a reading."""
    return isinstance(ref, ReadingKey)


def _with_certificate(payload: bytes) -> bytes:
    """A signed payload with its sensor's certificate, stored with the reading. Raises PayloadError without one."""
    if Envelope.parse(payload).certificate is None:
        raise PayloadError("reading: expected the sensor's certificate with it", "not_signed")
    return payload


def _acknowledge(message: Inbound) -> list[Effect]:
    return [Acknowledge(SENSORS, message.receipt)] if message.receipt is not None else []
