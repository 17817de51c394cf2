"""The messages of sensors: a reading, and the acknowledgement that it is safe (docs/protocol.md, section 9).

A reading's key is (drone, sensor, boot, seq): `boot` is random at each start of the sensor, `seq` rises by one
with each of its readings, whatever their kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ..errors import PayloadError
from .fields import U32, VERSION, Finite, Integer, Items, Session, Text, Version
from .names import MAX_SENSOR

UNITS = {"temperature": "degC", "humidity": "%", "light": "lx"}
"""The kinds whose unit need not travel, because it is always the same."""
MOST_ACKNOWLEDGED = 100

SensorNumber = Annotated[int, Integer(1, MAX_SENSOR)]
UnixMilliseconds = Annotated[int, Integer(0, 2**53 - 1)]
"""Milliseconds since 1970 UTC by the sensor's own clock: for people and charts, never for deadlines."""


@dataclass(frozen=True, kw_only=True)
class ReadingMessage:
    """One value of a sensor, whose kind is the topic's last level, with the time at which it was measured.

    The unit is left out where the kind has one of its own: °C, %, lx. Of other kinds it travels, unless the value
    has none.
    """

    version: Version = VERSION
    boot: Session
    seq: U32
    time_ms: UnixMilliseconds
    value: Annotated[float, Finite()]
    unit: Annotated[str, Text(16)] | None = None


@dataclass(frozen=True, kw_only=True, order=True)
class ReadingKey:
    """What names a reading of one drone."""

    sensor: SensorNumber
    boot: Session
    seq: U32

    def __str__(self) -> str:
        return f"sensor {self.sensor} {self.boot:08x}:{self.seq}"


@dataclass(frozen=True, kw_only=True)
class ReadingAck:
    """Readings that are safe with whoever says so, and need not be sent again."""

    version: Version = VERSION
    readings: Annotated[tuple[ReadingKey, ...], Items(MOST_ACKNOWLEDGED)]


@dataclass(frozen=True)
class Reading:
    """A reading on its way, as every node between its sensor and the ground station holds it.

    `said` is what its sensor signed, with the sensor's certificate; empty where readings are not signed.
    """

    sensor: int
    kind: str
    message: ReadingMessage
    said: bytes = b""

    @property
    def key(self) -> ReadingKey:
        return ReadingKey(sensor=self.sensor, boot=self.message.boot, seq=self.message.seq)

    @property
    def unit(self) -> str:
        """The value's unit, empty if it has none."""
        return UNITS.get(self.kind) or self.message.unit or ""


def checked(sensor: int, kind: str, message: ReadingMessage, said: bytes = b"") -> Reading:
    """The reading. Raises PayloadError for a unit that its kind does not have, or with unprintable characters."""
    expected = UNITS.get(kind)
    if expected is not None and message.unit not in (None, expected):
        raise PayloadError(f"unit: expected {expected} for {kind}, or none, got {message.unit!r}")
    if message.unit is not None and not message.unit.isprintable():
        raise PayloadError(f"unit: expected printable characters, got {message.unit!r}")
    return Reading(sensor, kind, message, said)
