"""Single values on the wire: the conversion of each kind of field to and from CBOR and JSON."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import is_dataclass
from enum import Enum
from typing import Annotated, Any, NoReturn, get_args, get_origin

from ..errors import PayloadError
from .fields import Binary, Constant, Finite, Integer, Items, Name, Named, Real, Scaled, Text
from .names import NAME_EXPECTED

Plain = Any
"""A value that cbor2 and json read and write."""


class Encoding(Enum):
    """The two forms of a payload."""

    CBOR = "cbor"
    JSON = "json"


Converters = tuple[Callable[[Any, Encoding], Plain], Callable[[Plain, Encoding, str], Any]]
"""Conversions to a form and back; the latter takes the field's path for its errors and raises PayloadError."""


def refuse(path: str, expected: str, got: object) -> NoReturn:
    """Raise PayloadError with the field, the expectation and the received value."""
    raise PayloadError(f"{path or 'payload'}: expected {expected}, got {shown(got)}")


def shown(value: object) -> str:
    """A received value as an error's text shows it. Python refuses to write very long numbers in decimal."""
    try:
        return repr(value)[:60]
    except ValueError:
        return "a very long number"


def mark_of(hint: Any) -> Any:
    """The mark of an annotated type; any other type itself."""
    return get_args(hint)[1] if get_origin(hint) is Annotated else hint


def item_of(hint: Any) -> Any:
    """The type of an annotated tuple's items."""
    return get_args(get_args(hint)[0])[0]


def whole_numbers(mark: Any) -> range | frozenset[int] | None:
    """The allowed integers of a field that CBOR only carries as integers; None for any other field."""
    if isinstance(mark, Integer):
        return range(mark.low, mark.high + 1)
    if isinstance(mark, Scaled):
        return range(round(mark.low * mark.per_unit), round(mark.high * mark.per_unit) + 1)
    if isinstance(mark, type) and issubclass(mark, Named):
        return frozenset(int(member) for member in mark)
    return None


def converters(hint: Any, nested: Callable[[type[Any]], Converters]) -> Converters:
    """The conversions of a value of type `hint` to and from both forms; `nested` gives those of messages."""
    mark = mark_of(hint)
    if isinstance(mark, Integer):
        return _integer(mark.low, mark.high)
    if isinstance(mark, Constant):
        return _constant(mark.value)
    if isinstance(mark, Scaled):
        return _scaled(mark)
    if isinstance(mark, Real):
        return _real(mark.largest)
    if isinstance(mark, Finite):
        return _finite()
    if isinstance(mark, Text):
        return _text(mark)
    if isinstance(mark, Binary):
        return _binary(mark)
    if isinstance(mark, Items):
        return _items(mark, item_of(hint), nested)
    if mark is bool:
        return _boolean()
    if isinstance(mark, type) and issubclass(mark, Named):
        return _named(mark)
    if isinstance(mark, type) and is_dataclass(mark):
        return nested(mark)
    raise TypeError(f"no wire form for {hint!r}")


def _integer(low: int, high: int) -> Converters:
    def check(value: Plain, _: Encoding, path: str = "field") -> int:
        if type(value) is not int or not low <= value <= high:
            refuse(path, f"a whole number from {low} to {high}", value)
        return int(value)

    return check, check


def _constant(constant: int) -> Converters:
    def check(plain: Plain, _: Encoding, path: str) -> int:
        if type(plain) is not int or plain != constant:
            raise PayloadError(f"{path}: expected {constant}, got {shown(plain)}", "version")
        return constant

    return (lambda value, _: constant), check


def _scaled(mark: Scaled) -> Converters:
    low, high = round(mark.low * mark.per_unit), round(mark.high * mark.per_unit)
    expected = f"a number from {mark.low:g} to {mark.high:g}"
    furthest = max(abs(mark.low), abs(mark.high)) + 1  # NaN, infinity and huge numbers never get to round()

    def quantise(value: Plain, path: str) -> int:
        if type(value) not in (int, float) or not abs(value) <= furthest:
            refuse(path, expected, value)
        ticks: int = round(value * mark.per_unit)
        if not low <= ticks <= high:
            refuse(path, expected, value)
        return ticks

    def to_plain(value: Any, encoding: Encoding) -> Plain:
        ticks = quantise(value, "field")
        return ticks if encoding is Encoding.CBOR else ticks / mark.per_unit

    def from_plain(plain: Plain, encoding: Encoding, path: str) -> float:
        if encoding is Encoding.JSON:
            return quantise(plain, path) / mark.per_unit
        if type(plain) is not int or not low <= plain <= high:
            refuse(path, f"a whole number from {low} to {high}", plain)
        return plain / mark.per_unit

    return to_plain, from_plain


def _real(largest: float) -> Converters:
    def from_plain(plain: Plain, _: Encoding, path: str) -> float | None:
        if plain is None:
            return None
        if type(plain) not in (int, float) or not abs(plain) <= largest:
            refuse(path, f"a number of at most {largest:g} in size, or null", plain)
        return float(plain)

    def to_plain(value: Any, encoding: Encoding) -> Plain:
        return None if value is None or value != value else from_plain(value, encoding, "field")

    return to_plain, from_plain


def _finite() -> Converters:
    def check(value: Plain, _: Encoding, path: str = "field") -> float:
        # NaN, infinity and integers beyond the largest 64-bit float fail the comparison.
        if type(value) not in (int, float) or not abs(value) <= sys.float_info.max:
            refuse(path, "a finite number", value)
        return float(value)

    def to_plain(value: Any, encoding: Encoding) -> Plain:
        number = check(value, encoding)
        is_short = encoding is Encoding.CBOR and number.is_integer() and abs(number) < 2**53
        return int(number) if is_short else number

    return to_plain, check


def _text(mark: Text) -> Converters:
    def from_plain(plain: Plain, _: Encoding, path: str) -> str:
        if not isinstance(plain, str) or len(plain) > mark.longest:
            refuse(path, f"a string of at most {mark.longest} characters", plain)
        if any("\ud800" <= character <= "\udfff" for character in plain):
            refuse(path, "text that UTF-8 can carry", plain)
        if isinstance(mark, Name) and not re.fullmatch(mark.pattern, plain):
            refuse(path, NAME_EXPECTED, plain)
        return plain

    def cut(value: Any, _: Encoding) -> str:
        return str(value)[: mark.longest].encode(errors="replace").decode()

    def checked(value: Any, encoding: Encoding) -> str:
        return from_plain(value, encoding, "field")

    return checked if isinstance(mark, Name) else cut, from_plain  # a name that was cut would be another one


def _binary(mark: Binary) -> Converters:
    size = f"{mark.most}" if mark.least == mark.most else f"{mark.least} to {mark.most}"
    digits = re.compile(rf"([0-9a-f]{{2}}){{{mark.least},{mark.most}}}")

    def from_plain(plain: Plain, encoding: Encoding, path: str) -> bytes:
        if encoding is Encoding.JSON:
            if not isinstance(plain, str) or not digits.fullmatch(plain):
                refuse(path, f"{size} bytes in hexadecimal", plain)
            return bytes.fromhex(plain)
        if not isinstance(plain, bytes) or not mark.least <= len(plain) <= mark.most:
            refuse(path, f"a string of {size} bytes", plain)
        return plain

    def to_plain(value: Any, encoding: Encoding) -> Plain:
        found = from_plain(value, Encoding.CBOR, "field")
        return found.hex() if encoding is Encoding.JSON else found

    return to_plain, from_plain


def _items(mark: Items, inner: Any, nested: Callable[[type[Any]], Converters]) -> Converters:
    to_item, from_item = converters(inner, nested)
    expected = f"at most {mark.most}" if mark.least == 0 else f"{mark.least} to {mark.most}"
    if mark.least == mark.most:
        expected = f"{mark.most}"

    def to_plain(value: Any, encoding: Encoding) -> Plain:
        if not mark.least <= len(value) <= mark.most:
            raise PayloadError(f"field: expected {expected} items, got {len(value)}")
        return [to_item(item, encoding) for item in value]

    def from_plain(plain: Plain, encoding: Encoding, path: str) -> tuple[Any, ...]:
        if not isinstance(plain, list) or not mark.least <= len(plain) <= mark.most:
            refuse(path, f"an array of {expected} items", plain)
        return tuple(from_item(item, encoding, f"{path}[{i}].") for i, item in enumerate(plain))

    return to_plain, from_plain


def _boolean() -> Converters:
    def from_plain(plain: Plain, _: Encoding, path: str) -> bool:
        if type(plain) is not bool:
            refuse(path, "true or false", plain)
        return plain

    return (lambda value, _: bool(value)), from_plain


def _named(enum: type[Named]) -> Converters:
    by_label = {member.label: member for member in enum}
    by_code = {int(member): member for member in enum}

    def from_plain(plain: Plain, encoding: Encoding, path: str) -> Named:
        if encoding is Encoding.JSON:
            member = by_label.get(plain) if isinstance(plain, str) else None
        else:
            member = by_code.get(plain) if type(plain) is int else None
        if member is None:
            refuse(path, f"one of {', '.join(by_label)}", plain)
        return member

    return (lambda value, encoding: int(value) if encoding is Encoding.CBOR else enum(value).label), from_plain
