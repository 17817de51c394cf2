"""A sensor node as a state machine: it measures on schedule and keeps each reading until it is stored elsewhere.

A drone acknowledges the readings that it has stored; of a plain broker the PUBACK is the only sign.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from itertools import takewhile

from mqttxt.core.channel import Channel
from mqttxt.core.effects import Effect, Inbound, Log, Publish, Subscribe
from mqttxt.core.settings import Retry, Settings
from mqttxt.errors import PayloadError
from mqttxt.protocol.codec import decode
from mqttxt.protocol.readings import Reading, ReadingAck, ReadingKey, ReadingMessage
from mqttxt.protocol.topics import SensorSide
from mqttxt.security.cose import Envelope
from mqttxt.security.seal import Seal, is_drone

from .model import QUANTITIES, value

LINK = "broker"
_REFUSED = 0x80
"""The lowest reason code by which a PUBACK refuses a message (MQTT 5.0, 2.4)."""
WINDOW = 100
"""The most readings that may be sent and unacknowledged at once."""


@dataclass(frozen=True)
class SensorOptions:
    """What a sensor measures and when.

    rate_hz       readings of each kind per second
    samples       readings of each kind in all, None for no end
    keep          the most unacknowledged readings that are kept
    when_reached  measure nothing before the first connection
    stays         stay connected when all samples are measured
    plain         the broker belongs to no drone: its PUBACK means that a reading is stored
    """

    number: int = 1
    kinds: tuple[str, ...] = tuple(QUANTITIES)
    rate_hz: float = 1.0
    seed: int = 1
    samples: int | None = None
    keep: int = 10_000
    when_reached: bool = False
    stays: bool = False
    plain: bool = False


@dataclass(frozen=True)
class Measured:
    """A reading was measured; for the event file."""

    reading: Reading


@dataclass(frozen=True)
class Dropped:
    """A reading was dropped to make room for newer ones."""

    reading: Reading


@dataclass(frozen=True)
class Finished:
    """All samples are measured, and each reading is stored elsewhere or dropped."""


Output = Effect | Measured | Dropped | Finished


@dataclass
class _Kept:
    """A reading that is not acknowledged yet; `retry` is set from the broker's PUBACK on."""

    reading: Reading
    is_sent: bool = False
    retry: Retry | None = None


class SensorNode:
    """One boot of a sensor. Times are milliseconds of its session clock; `unix_ms` reads its wall clock.

    With a `seal` it signs its readings, and accepts only acknowledgements that a drone has signed.
    """

    def __init__(
        self,
        boot: int,
        options: SensorOptions,
        settings: Settings,
        unix_ms: Callable[[], int],
        seal: Seal | None = None,
    ) -> None:
        self.options = options
        self.side = SensorSide()
        self._boot = boot
        self._channel = Channel(LINK, "", settings, seal)
        self._unix_ms = unix_ms
        self._kept: dict[ReadingKey, _Kept] = {}
        self._seq = 0
        self._taken = 0
        self._next_ms: float | None = None
        self._is_up = False
        self._was_reached = not options.when_reached
        self._under_way = 0

    def on_connected(self, link: str, now_ms: int) -> list[Output]:
        """Subscribe to the drone's acknowledgements first; to a plain broker send at once."""
        self._was_reached = True
        if self.options.plain:
            self._is_up = True
            return self._send(now_ms)
        return [Subscribe(LINK, (self.side.ack,), live_only=True)]

    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> list[Output]:
        """Send, now that acknowledgements can arrive."""
        self._is_up = True
        return self._send(now_ms)

    def on_disconnected(self, link: str, now_ms: int) -> list[Output]:
        """Mark all readings as not sent: they may be lost."""
        self._is_up = False
        self._under_way = 0
        for kept in self._kept.values():
            kept.is_sent, kept.retry = False, None
        return []

    def on_message(self, link: str, message: Inbound, now_ms: int) -> list[Output]:
        """Forget readings named in a `sensor_ack` (for all sensors of the drone)."""
        try:
            keys = decode(ReadingAck, self._of_drone(message.payload)).readings
        except PayloadError as error:
            return [Log("acknowledgement", f"{message.topic}: {error}")]
        for key in keys:
            self._forget(key)
        return self._send(now_ms)

    def on_published(self, link: str, ref: Hashable, code: int, now_ms: int) -> list[Output]:
        """Forget a reading that a plain broker has taken; any other is repeated later, until `sensor_ack` names it."""
        kept = self._kept.get(ref) if isinstance(ref, ReadingKey) else None
        if kept is not None and self.options.plain and code < _REFUSED:
            self._forget(kept.reading.key)
            return self._send(now_ms)
        if kept is not None and kept.is_sent and kept.retry is None:
            kept.retry = Retry.unanswered(now_ms)
        return []

    def on_identity(self, now_ms: int) -> list[Output]:
        """Sign with the renewed key from now on."""
        if self._channel.seal is not None:
            self._channel.seal.on_identity()
        return []

    def tick(self, now_ms: int) -> list[Output]:
        """Measure due readings, send new ones, and repeat those that were not acknowledged in time."""
        out = self._measure(now_ms) + self._send(now_ms)
        if self._is_up:
            sent = takewhile(lambda kept: kept.is_sent, self._kept.values())  # they are the oldest
            due = [kept for kept in sent if kept.retry is not None and kept.retry.is_due(now_ms)]
            out += [self._publish(kept) for kept in due]
        if self._is_finished() and not self._kept and not self.options.stays:
            out.append(Finished())
        return out

    def goodbye(self, now_ms: int) -> list[Output]:
        return []

    def is_ready(self, now_ms: int) -> bool:
        return self._is_up

    def _is_finished(self) -> bool:
        return self.options.samples is not None and self._taken >= self.options.samples

    def _measure(self, now_ms: int) -> list[Output]:
        out: list[Output] = []
        if not self._was_reached:
            return out
        if self._next_ms is None:
            self._next_ms = now_ms
        while now_ms >= self._next_ms and not self._is_finished():
            time_ms = self._unix_ms() - round(now_ms - self._next_ms)
            self._next_ms += 1000 / self.options.rate_hz
            self._taken += 1
            for kind in self.options.kinds:
                out += self._keep(kind, time_ms)
        return out

    def _keep(self, kind: str, time_ms: int) -> list[Output]:
        measured = value(kind, time_ms, self.options.seed)
        message = ReadingMessage(boot=self._boot, seq=self._seq, time_ms=time_ms, value=measured)
        self._seq += 1
        reading = Reading(self.options.number, kind, message)
        out: list[Output] = [Measured(reading)]
        if len(self._kept) >= self.options.keep:
            oldest = next(iter(self._kept.values())).reading
            self._forget(oldest.key)
            out += [Log("dropped", f"{oldest.key}: {self.options.keep} readings are unacknowledged"), Dropped(oldest)]
        self._kept[reading.key] = _Kept(reading)
        return out

    def _forget(self, key: ReadingKey) -> None:
        kept = self._kept.pop(key, None)
        if kept is not None and kept.is_sent:
            self._under_way -= 1

    def _send(self, now_ms: int) -> list[Output]:
        """Send readings that were not sent on this connection, oldest first, while the window has room."""
        out: list[Output] = []
        if not self._is_up or self._under_way >= WINDOW:
            return out
        for kept in self._kept.values():
            if not kept.is_sent:
                kept.is_sent = True
                self._under_way += 1
                out.append(self._publish(kept))
                if self._under_way >= WINDOW:
                    break
        return out

    def _publish(self, kept: _Kept) -> Publish:
        reading = kept.reading
        topic = self.side.sensor(reading.sensor, reading.kind)
        return self._channel.publish(topic, reading.message, qos=1, ref=reading.key, with_certificate=True)

    def _of_drone(self, payload: bytes) -> bytes:
        """An acknowledgement's payload; if this sensor signs, raises PayloadError for one that no drone has signed."""
        seal = self._channel.seal
        if seal is None:
            return payload
        return seal.verified(Envelope.parse(payload), lambda _: self.side.ack, is_drone).payload
