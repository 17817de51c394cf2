"""Payloads to and from bytes: CBOR by default, JSON for people; the first byte shows which.

Decoding refuses an unknown version or field, a wrong type, a value out of range and NaN, with a PayloadError that names
the field; it never guesses. Both forms decode to equal dataclasses.
"""

from __future__ import annotations

import json
import types
from collections.abc import Callable, Container
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, NoReturn, TypeVar, Union, get_args, get_origin, get_type_hints

from ..errors import PayloadError
from .cbor import check_length, encode_plain, read_cbor
from .fields import Integer, Items, Variant
from .values import Converters, Encoding, Plain, converters, item_of, mark_of, refuse, whole_numbers

_JSON = b"{"
"""The first byte of a JSON object; no message in CBOR begins with it."""


Message = TypeVar("Message")


@dataclass(frozen=True)
class FieldLayout:
    """One field of a message: its name, whether it may be missing, and its conversions to and from both forms.

    Integers in `as_is` are the same in both forms.
    """

    name: str
    optional: bool
    mark: Any
    as_is: range
    to_plain: Callable[[Any, Encoding], Plain]
    from_plain: Callable[[Plain, Encoding, str], Any]


@dataclass(frozen=True)
class Layout:
    """A message's fields in order, and its variant if it ends in one.

    `whole` has each field's allowed integers in CBOR if all fields are integers, otherwise None.
    """

    cls: type[Any]
    fields: tuple[FieldLayout, ...]
    variant: tuple[str, Variant] | None
    required: int
    whole: tuple[Container[int], ...] | None


def encode(message: object, encoding: Encoding = Encoding.CBOR) -> bytes:
    """The bytes of a message. Raises PayloadError if a field cannot be carried."""
    if encoding is Encoding.JSON:
        return json.dumps(_to_object(message), separators=(",", ":"), allow_nan=False).encode()
    return encode_plain(_to_array(message))


def decode(cls: type[Message], payload: bytes) -> Message:
    """The message of type `cls` in `payload`. Raises PayloadError."""
    return cls(**decode_values(cls, payload))


def decode_values(cls: type[Any], payload: bytes) -> dict[str, Any]:
    """The checked values of a message's fields, by name, without making the message. Raises PayloadError."""
    check_length(payload)
    if payload[:1] != _JSON:
        return values_of_array(cls, read_cbor(payload))
    try:
        plain = json.loads(payload.decode("utf-8"), parse_constant=_reject_constant, object_pairs_hook=_unique)
    except (ValueError, RecursionError) as error:
        raise PayloadError(f"payload: not JSON: {error}") from error
    return _values_of_object(cls, plain, "")


def plain_of(
    cls: type[Any], payload: bytes, is_plainly_right: Callable[[Plain], bool] = lambda plain: False
) -> list[Plain]:
    """The CBOR array of a message of type `cls`, checked but not made into a message. Raises PayloadError.

    `is_plainly_right` returns True for arrays that need no full check.
    """
    if payload[:1] == _JSON:
        return _to_array(decode(cls, payload))
    check_length(payload)
    plain: list[Plain] = read_cbor(payload)
    if not is_whole(_LAYOUTS[cls].whole, plain) and not is_plainly_right(plain):
        values_of_array(cls, plain)
    return plain


def is_whole(fields: tuple[Container[int], ...] | None, plain: Plain) -> bool:
    """Whether each field of an array is an allowed integer; False if in doubt."""
    if fields is None or type(plain) is not list or len(plain) != len(fields):
        return False
    for value, allowed in zip(plain, fields, strict=True):
        if type(value) is not int or value not in allowed:
            return False
    return True


def encoding_of(payload: bytes) -> Encoding:
    """The form of a payload, by its first byte."""
    return Encoding.JSON if payload[:1] == _JSON else Encoding.CBOR


def layout_of(cls: type[Any]) -> Layout:
    """The layout of `cls`, by its annotations."""
    return _LAYOUTS[cls]


class _Layouts(dict[type[Any], Layout]):
    """The layout of each class, made at its first lookup."""

    def __missing__(self, cls: type[Any]) -> Layout:
        self[cls] = _make_layout(cls)
        return self[cls]


_LAYOUTS = _Layouts()


def _make_layout(cls: type[Any]) -> Layout:
    hints = get_type_hints(cls, include_extras=True)
    laid_out: list[FieldLayout] = []
    variant = None
    for field in fields(cls):
        mark = mark_of(hints[field.name])
        if isinstance(mark, Variant):
            variant = (field.name, mark)
            continue
        inner, optional = _strip_optional(hints[field.name])
        if optional and field.default is MISSING:
            raise TypeError(f"{cls.__name__}.{field.name}: an optional field needs the default None")
        to_plain, from_plain = converters(inner, _nested)
        own = mark_of(inner)
        if isinstance(own, Items):
            own = replace(own, of=mark_of(item_of(inner)))
        as_is = range(own.low, own.high + 1) if isinstance(own, Integer) else range(0)
        laid_out.append(FieldLayout(field.name, optional, own, as_is, to_plain, from_plain))
    required = max((i + 1 for i, field in enumerate(laid_out) if not field.optional), default=0)
    whole = tuple(whole_numbers(field.mark) or () for field in laid_out if not field.optional)
    is_whole = variant is None and len(whole) == len(laid_out) and all(whole)
    return Layout(cls, tuple(laid_out), variant, required, whole if is_whole else None)


def _reject_constant(text: str) -> NoReturn:
    raise PayloadError(f"payload: expected a number, got {text}")


def _unique(pairs: list[tuple[str, Plain]]) -> dict[str, Plain]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise PayloadError("payload: expected each field once")
    return found


def _to_array(message: object) -> list[Plain]:
    layout = _LAYOUTS[type(message)]
    row = _written(layout, message, Encoding.CBOR)
    if layout.variant is None:
        while len(row) > layout.required and row[-1] is None:
            row.pop()
        return row
    name, variant = layout.variant
    body = getattr(message, name)
    return [*row, variant.tag(body)[0], *_to_array(body)]


def _to_object(message: object) -> dict[str, Plain]:
    layout = _LAYOUTS[type(message)]
    written = zip(layout.fields, _written(layout, message, Encoding.JSON), strict=True)
    found = {field.name: value for field, value in written if value is not None or not field.optional}
    if layout.variant is not None:
        name, variant = layout.variant
        body = getattr(message, name)
        found[name] = variant.tag(body)[1]
        found.update(_to_object(body))
    return found


def _written(layout: Layout, message: object, encoding: Encoding) -> list[Plain]:
    """The values of a message's fields in one of the forms. Raises PayloadError naming the field."""
    row: list[Plain] = []
    for field in layout.fields:
        value = getattr(message, field.name)
        try:
            if not ((type(value) is int and value in field.as_is) or (value is None and field.optional)):
                value = field.to_plain(value, encoding)
        except PayloadError as error:
            raise PayloadError(str(error).replace("field", field.name, 1), error.kind) from None
        row.append(value)
    return row


def values_of_array(cls: type[Any], plain: Plain, path: str = "") -> dict[str, Any]:
    """The values of a message's fields, by name, from its CBOR array, which is at `path`. Raises PayloadError."""
    if not isinstance(plain, list):
        refuse(path, "an array", plain)
    layout = _LAYOUTS[cls]
    values: dict[str, Any] = {}
    for index, field in enumerate(layout.fields):
        if index >= len(plain):
            if index < layout.required:
                refuse(f"{path}{field.name}", "a value", "nothing")
            break
        value = plain[index]
        if not ((type(value) is int and value in field.as_is) or (value is None and field.optional)):
            value = field.from_plain(value, Encoding.CBOR, path + field.name)
        values[field.name] = value
    count = len(layout.fields)
    if layout.variant is not None:
        name, variant = layout.variant
        if len(plain) <= count:
            refuse(f"{path}{name}", "a value", "nothing")
        body = variant.by_code.get(plain[count]) if type(plain[count]) is int else None
        if body is None:
            refuse(f"{path}{name}", f"a known {variant.name}", plain[count])
        values[name] = body(**values_of_array(body, plain[count + 1 :], path))
    elif len(plain) > count:
        refuse(path, f"at most {count} fields", len(plain))
    return values


def _values_of_object(cls: type[Any], plain: Plain, path: str) -> dict[str, Any]:
    if not isinstance(plain, dict):
        refuse(path, "an object", plain)
    layout = _LAYOUTS[cls]
    left = dict(plain)
    values: dict[str, Any] = {}
    for field in layout.fields:
        if field.name in left:
            value = left.pop(field.name)
            if value is not None or not field.optional:
                value = field.from_plain(value, Encoding.JSON, path + field.name)
            values[field.name] = value
        elif not field.optional:
            refuse(f"{path}{field.name}", "a value", "nothing")
    if layout.variant is not None:
        name, variant = layout.variant
        label = left.pop(name, None)
        body = next((c for _, known, c in variant.codes if known == label), None)
        if body is None:
            refuse(f"{path}{name}", f"a known {variant.name}", label)
        values[name] = body(**_values_of_object(body, left, path))
    elif left:
        refuse(path, f"fields of {cls.__name__}", sorted(left))
    return values


def _strip_optional(hint: Any) -> tuple[Any, bool]:
    if get_origin(hint) in (Union, types.UnionType):
        inner = [arg for arg in get_args(hint) if arg is not type(None)]
        if len(inner) == 1:
            return inner[0], True
    return hint, False


def _nested(cls: type[Any]) -> Converters:
    def to_plain(value: Any, encoding: Encoding) -> Plain:
        return _to_object(value) if encoding is Encoding.JSON else _to_array(value)

    def from_plain(plain: Plain, encoding: Encoding, path: str) -> Any:
        prefix = path if path.endswith(".") else f"{path}."
        read = _values_of_object if encoding is Encoding.JSON else values_of_array
        return cls(**read(cls, plain, prefix))

    return to_plain, from_plain
