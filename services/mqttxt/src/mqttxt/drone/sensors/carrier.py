"""Carries sensors' readings on a drone: from its own broker into a store, and on to the fog (docs/protocol.md).

A reading is acknowledged to its sensor once it is stored, and leaves the store once the activator has acknowledged it.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass

from ...core.effects import Inbound, Log, Publish, Subscribe
from ...core.settings import Retry, Settings
from ...errors import PayloadError
from ...protocol.codec import decode, encode
from ...protocol.readings import MOST_ACKNOWLEDGED, Reading, ReadingAck, ReadingKey, ReadingMessage, checked
from ...protocol.topics import FogSide, SensorSide
from ..effects import Acknowledge, Effect, ForgetReadings, LoadReadings, StoreReading

SENSORS = "sensors"
"""The connection to the drone's own broker."""
WINDOW = 32
"""Readings that may be on their way to the activator at once: a stalled link holds no more of them."""


@dataclass
class UnderWay:
    """A reading under way; `retry` from the broker's PUBACK on, before it the transport repeats."""

    reading: Reading
    retry: Retry | None = None


class Carrier:
    """The sensors' side of a UAV client. Times are milliseconds of its session clock; `link` is the fog's broker."""

    def __init__(self, drone: int, link: str, settings: Settings, fog_side: FogSide) -> None:
        self.side = SensorSide()
        self._drone = drone
        self._link = link
        self._settings = settings
        self._fog = fog_side
        self._under_way: dict[ReadingKey, UnderWay] = {}
        self._place = 0
        self._is_loading = False
        self._may_have_more = True
        self._fog_is_up = False

    def on_connected(self, now_ms: int) -> list[Effect]:
        """The drone's own broker is there."""
        return [Subscribe(SENSORS, (self.side.filter,), live_only=True)]

    def on_message(self, message: Inbound, now_ms: int) -> list[Effect]:
        """From the drone's own broker: a reading, or something that is counted and dropped."""
        try:
            sensor, kind = self.side.parse(message.topic)
            reading = checked(sensor, kind, decode(ReadingMessage, message.payload))
        except PayloadError as error:
            kind = "sensor_topic" if error.kind == "topic" else "sensor_reading"
            return [Log(kind, f"{message.topic[:100]}: {error}"), *_acknowledge(message)]
        return [StoreReading(reading, message.receipt)]

    def on_stored(self, stored: Iterable[StoreReading], now_ms: int) -> list[Effect]:
        """Readings are on the disk: their sensors need not keep them any longer."""
        effects = [*stored]
        self._may_have_more = self._may_have_more or bool(effects)
        out: list[Effect] = [Acknowledge(SENSORS, e.receipt) for e in effects if e.receipt is not None]
        for start in range(0, len(effects), MOST_ACKNOWLEDGED):
            keys = tuple(e.reading.key for e in effects[start : start + MOST_ACKNOWLEDGED])
            payload = encode(ReadingAck(readings=keys), self._settings.encoding)
            out.append(Publish(SENSORS, self.side.ack, payload, qos=1))
        return out + self._load()

    def on_refused(self, refused: Iterable[StoreReading], reason: str, now_ms: int) -> list[Effect]:
        """Readings that could not be stored stay with their sensors, which hear nothing of them."""
        out: list[Effect] = []
        for effect in refused:
            out.append(Log("sensor_store", f"{reason}; new readings stay with their sensors until there is room"))
            if effect.receipt is not None:
                out.append(Acknowledge(SENSORS, effect.receipt))
        return out

    def on_fog_up(self, now_ms: int) -> list[Effect]:
        """This session's birth is published: what was under way on an earlier connection may be lost."""
        self._fog_is_up = True
        for sent in self._under_way.values():
            sent.retry = None
        return [*map(self._publish, self._under_way.values()), *self._load()]

    def on_fog_down(self) -> None:
        self._fog_is_up = False

    def on_new_activator(self, now_ms: int) -> None:
        """Another session of the activator: what the one before it took along may be lost."""
        for sent in self._under_way.values():
            if sent.retry is not None:
                sent.retry = Retry(now_ms)

    def on_loaded(self, rows: list[tuple[int, Reading]], most: int, now_ms: int) -> list[Effect]:
        """Stored readings, each with its place, in answer to a LoadReadings of `most`."""
        self._is_loading = False
        self._may_have_more = len(rows) >= most
        out: list[Effect] = []
        for place, reading in rows:
            self._place = max(self._place, place)
            sent = self._under_way[reading.key] = UnderWay(reading)
            if self._fog_is_up:
                out.append(self._publish(sent))
        return out + self._load()

    def on_published(self, key: ReadingKey, code: int, now_ms: int) -> list[Effect]:
        """The fog's broker has it. Nothing keeps it there, so the activator's word is waited for."""
        sent = self._under_way.get(key)
        if sent is not None and sent.retry is None:
            sent.retry = Retry.unanswered(now_ms)
        return []

    def on_ack(self, payload: bytes, now_ms: int) -> list[Effect]:
        """`droneY/sensor_ack`; raises PayloadError."""
        keys = decode(ReadingAck, payload).readings
        for key in keys:
            self._under_way.pop(key, None)
        return [ForgetReadings(keys), *self._load()]

    def tick(self, now_ms: int) -> list[Effect]:
        """What the activator has not acknowledged in time is sent again; more is loaded when there is room."""
        out: list[Effect] = []
        if self._fog_is_up:
            due = [f for f in self._under_way.values() if f.retry is not None and f.retry.is_due(now_ms)]
            out += [self._publish(sent) for sent in due]
        return out + self._load()

    def _load(self) -> list[Effect]:
        room = WINDOW - len(self._under_way)
        if not self._fog_is_up or self._is_loading or not self._may_have_more or room == 0:
            return []
        self._is_loading = True
        return [LoadReadings(self._place, room)]

    def _publish(self, sent: UnderWay) -> Publish:
        reading = sent.reading
        topic = self._fog.sensor(self._drone, reading.sensor, reading.kind)
        payload = encode(reading.message, self._settings.encoding)
        return Publish(self._link, topic, payload, qos=1, ref=reading.key)


def is_carried(ref: Hashable) -> bool:
    """Whether a publish's `ref` is of a reading."""
    return isinstance(ref, ReadingKey)


def _acknowledge(message: Inbound) -> list[Effect]:
    return [Acknowledge(SENSORS, message.receipt)] if message.receipt is not None else []
