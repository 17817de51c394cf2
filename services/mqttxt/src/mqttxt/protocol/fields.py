"""Marks that declare the wire form of a message's fields in their annotations.

A message is a frozen dataclass whose annotations carry one of these marks. From them `codec` makes the
CBOR form (positional arrays, integers in MAVLink's units) and the JSON form (objects with named fields in
SI units), and `spec.schema` makes the JSON Schema and the CDDL.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Annotated, Any

from ..errors import PayloadError
from .names import NAME

FLOAT32_MAX = 3.4028234663852886e38
"""The largest finite number of 32 bits (IEEE 754), as MAVLink's floats have them."""


@dataclass(frozen=True)
class Integer:
    """A whole number from low to high, the same in both forms."""

    low: int
    high: int


@dataclass(frozen=True)
class Scaled:
    """A quantity in SI units; CBOR carries `round(value * per_unit)`, JSON the value so quantised."""

    per_unit: int
    low: float
    high: float


@dataclass(frozen=True)
class Real:
    """A floating-point number, at most `largest` in size, the same in both forms; null is MAVLink's NaN."""

    largest: float


@dataclass(frozen=True)
class Finite:
    """Any finite number of 64 bits, the same in both forms; CBOR carries whole ones as integers."""


@dataclass(frozen=True)
class Constant:
    """A whole number that can only have one value (the payload's version)."""

    value: int


@dataclass(frozen=True)
class Text:
    """A string of at most `longest` characters."""

    longest: int


@dataclass(frozen=True)
class Name(Text):
    """A name as topics have it (R2.1)."""

    longest: int = 64
    pattern: str = NAME


@dataclass(frozen=True)
class Binary:
    """`least` to `most` bytes: a byte string in CBOR, hexadecimal digits in lower case in JSON."""

    least: int
    most: int


@dataclass(frozen=True)
class Items:
    """A list of `least` to `most` items; `of` is their mark, which `codec` takes from the annotation."""

    most: int
    of: Any = None
    least: int = 0


@dataclass(frozen=True)
class Variant:
    """The last field of a message: one of several dataclasses, distinguished by a code (CBOR) or name (JSON).

    Its own fields follow the tag on the same level.
    """

    name: str
    codes: tuple[tuple[int, str, type[Any]], ...]

    @cached_property
    def by_code(self) -> dict[int, type[Any]]:
        return {code: cls for code, _, cls in self.codes}

    @cached_property
    def tags(self) -> dict[type[Any], tuple[int, str]]:
        """The code and the name of each class."""
        return {cls: (code, label) for code, label, cls in self.codes}

    def tag(self, body: object) -> tuple[int, str]:
        """The code and the name of a body. Raises PayloadError for one of another class."""
        tag = self.tags.get(type(body))
        if tag is None:
            raise PayloadError(f"{self.name}: {type(body).__name__} cannot be carried")
        return tag


VERSION = 1

Version = Annotated[int, Constant(VERSION)]
U16 = Annotated[int, Integer(0, 2**16 - 1)]
U32 = Annotated[int, Integer(0, 2**32 - 1)]
Session = Annotated[int, Integer(1, 2**32 - 1)]
Milliseconds = Annotated[int, Integer(0, 2**53 - 1)]
"""A time in somebody's session clock; JSON numbers are exact up to 2**53."""
DroneNumber = Annotated[int, Integer(1, 250)]
Stamp = U16
StationName = Annotated[str, Name()]
Reason = Annotated[str, Text(200)]
HASH_BYTES = 16
Hash = Annotated[bytes, Binary(HASH_BYTES, HASH_BYTES)]
"""The first bytes of a SHA-256, which name what they were made of."""
Latitude = Annotated[float, Scaled(10_000_000, -90, 90)]
Longitude = Annotated[float, Scaled(10_000_000, -180, 180)]
Altitude = Annotated[float, Scaled(1000, -100_000, 100_000)]
"""Metres; CBOR carries millimetres as GLOBAL_POSITION_INT does."""


class Named(IntEnum):
    """An enumeration that CBOR carries as its value and JSON as its member's name in lower case."""

    @property
    def label(self) -> str:
        return self.name.lower()
