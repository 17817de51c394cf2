"""Payloads to and from bytes: CBOR by default, JSON for people; the first byte tells which.

Decoding refuses what it does not know (version, field, type, range, NaN) with a PayloadError that names the
field; it never guesses. Both forms decode to equal dataclasses.
"""

from __future__ import annotations

import json
import types
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, replace
from io import BytesIO
from typing import Any, NoReturn, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import cbor2

from ..errors import PayloadError
from .fields import Items, Variant
from .values import Converters, Encoding, Plain, converters, item_of, mark_of, refuse

MAX_PAYLOAD = 61_440
"""Bytes; a longer payload is refused unread. The rankings of 250 drones in JSON are shorter."""
_MAX_DEPTH = 8


def _refuse_reference(*_: Any) -> NoReturn:
    raise ValueError("a value that refers to another")


NO_REFERENCES = dict.fromkeys((25, 28, 29, 256), _refuse_reference)
"""Tags with which a few hundred bytes say more than a memory holds, once somebody writes or hashes the values."""

Message = TypeVar("Message")


@dataclass(frozen=True)
class FieldLayout:
    """One field of a message: its name, whether it may be missing, and its way in and out of both forms."""

    name: str
    optional: bool
    mark: Any
    to_plain: Callable[[Any, Encoding], Plain]
    from_plain: Callable[[Plain, Encoding, str], Any]


@dataclass(frozen=True)
class Layout:
    """A message's fields in order, and its variant where it ends in one."""

    cls: type[Any]
    fields: tuple[FieldLayout, ...]
    variant: tuple[str, Variant] | None
    required: int


_LAYOUTS: dict[type[Any], Layout] = {}


def encode(message: object, encoding: Encoding = Encoding.CBOR) -> bytes:
    """The bytes of a message; raises PayloadError when a field cannot be carried."""
    if encoding is Encoding.JSON:
        return json.dumps(_to_object(message), separators=(",", ":"), allow_nan=False).encode()
    return cbor2.dumps(_to_array(message), canonical=True)  # floats in the shortest form that loses nothing


def decode(cls: type[Message], payload: bytes) -> Message:
    """The message of type `cls` in `payload`; raises PayloadError."""
    plain, encoding = _parse(payload)
    if encoding is Encoding.JSON:
        return cast(Message, _from_object(cls, plain, ""))
    return cast(Message, _from_array(cls, plain, ""))


def decode_values(cls: type[Any], payload: bytes) -> dict[str, Any]:
    """The checked values of a message's fields, by name, where the message itself is not needed."""
    plain, encoding = _parse(payload)
    read = _values_of_object if encoding is Encoding.JSON else _values_of_array
    return read(cls, plain, "")


def encoding_of(payload: bytes) -> Encoding:
    """Which form a payload has, by its first byte."""
    return Encoding.JSON if payload[:1] == b"{" else Encoding.CBOR


def layout_of(cls: type[Any]) -> Layout:
    """How `cls` is written; made once a class from its annotations."""
    if cls not in _LAYOUTS:
        _LAYOUTS[cls] = _make_layout(cls)
    return _LAYOUTS[cls]


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
        laid_out.append(FieldLayout(field.name, optional, own, to_plain, from_plain))
    required = max((i + 1 for i, field in enumerate(laid_out) if not field.optional), default=0)
    return Layout(cls, tuple(laid_out), variant, required)


def _reject_constant(text: str) -> NoReturn:
    raise PayloadError(f"payload: expected a number, got {text}")


def _unique(pairs: list[tuple[str, Plain]]) -> dict[str, Plain]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise PayloadError("payload: expected each field once")
    return found


def _parse(payload: bytes) -> tuple[Plain, Encoding]:
    if not payload:
        raise PayloadError("payload: expected CBOR or JSON, got nothing", "empty")
    if len(payload) > MAX_PAYLOAD:
        raise PayloadError(f"payload: expected at most {MAX_PAYLOAD} bytes, got {len(payload)}", "too_long")
    if encoding_of(payload) is Encoding.CBOR:
        return _parse_cbor(payload), Encoding.CBOR
    try:
        text = payload.decode("utf-8")
        return json.loads(text, parse_constant=_reject_constant, object_pairs_hook=_unique), Encoding.JSON
    except (ValueError, RecursionError) as error:
        raise PayloadError(f"payload: not JSON: {error}") from error


def parse_cbor(data: bytes) -> Plain:
    """What one item of CBOR says; raises PayloadError for anything else."""
    if not 0 < len(data) <= MAX_PAYLOAD:
        raise PayloadError(f"payload: expected 1 to {MAX_PAYLOAD} bytes, got {len(data)}", "too_long")
    return _parse_cbor(data)


def _parse_cbor(payload: bytes) -> Plain:
    stream = BytesIO(payload)
    try:
        plain = cbor2.CBORDecoder(
            stream,
            max_depth=_MAX_DEPTH,
            allow_indefinite=False,
            allow_duplicate_keys=False,
            semantic_decoders=NO_REFERENCES,
        ).decode()
    except (ValueError, cbor2.CBORError, RecursionError) as error:
        raise PayloadError(f"payload: not CBOR: {error}") from error
    if stream.tell() != len(payload):
        raise PayloadError("payload: bytes behind the end of the message")
    return plain


def _to_array(message: object) -> list[Plain]:
    layout = layout_of(type(message))
    row = [_out(field, message, Encoding.CBOR) for field in layout.fields]
    if layout.variant is None:
        while len(row) > layout.required and row[-1] is None:
            row.pop()
        return row
    name, variant = layout.variant
    body = getattr(message, name)
    code, _ = _tag(variant, body)
    return [*row, code, *_to_array(body)]


def _to_object(message: object) -> dict[str, Plain]:
    layout = layout_of(type(message))
    written = [(field, _out(field, message, Encoding.JSON)) for field in layout.fields]
    found = {field.name: value for field, value in written if value is not None or not field.optional}
    if layout.variant is not None:
        name, variant = layout.variant
        body = getattr(message, name)
        found[name] = _tag(variant, body)[1]
        found.update(_to_object(body))
    return found


def _out(field: FieldLayout, message: object, encoding: Encoding) -> Plain:
    value = getattr(message, field.name)
    if value is None and field.optional:
        return None
    try:
        return field.to_plain(value, encoding)
    except PayloadError as error:
        raise PayloadError(str(error).replace("field", field.name, 1), error.kind) from None


def _tag(variant: Variant, body: object) -> tuple[int, str]:
    tag = variant.tags.get(type(body))
    if tag is None:
        raise PayloadError(f"{variant.name}: {type(body).__name__} cannot be carried")
    return tag


def _from_array(cls: type[Any], plain: Plain, path: str) -> object:
    return cls(**_values_of_array(cls, plain, path))


def _from_object(cls: type[Any], plain: Plain, path: str) -> object:
    return cls(**_values_of_object(cls, plain, path))


def _values_of_array(cls: type[Any], plain: Plain, path: str) -> dict[str, Any]:
    if not isinstance(plain, list):
        refuse(path, "an array", plain)
    layout = layout_of(cls)
    values: dict[str, Any] = {}
    for index, field in enumerate(layout.fields):
        if index >= len(plain):
            if index < layout.required:
                refuse(f"{path}{field.name}", "a value", "nothing")
            break
        values[field.name] = _in(field, plain[index], Encoding.CBOR, path)
    count = len(layout.fields)
    if layout.variant is not None:
        name, variant = layout.variant
        if len(plain) <= count:
            refuse(f"{path}{name}", "a value", "nothing")
        body = variant.by_code.get(plain[count]) if type(plain[count]) is int else None
        if body is None:
            refuse(f"{path}{name}", f"a known {variant.name}", plain[count])
        values[name] = _from_array(body, plain[count + 1 :], path)
    elif len(plain) > count:
        refuse(path, f"at most {count} fields", len(plain))
    return values


def _values_of_object(cls: type[Any], plain: Plain, path: str) -> dict[str, Any]:
    if not isinstance(plain, dict):
        refuse(path, "an object", plain)
    layout = layout_of(cls)
    left = dict(plain)
    values: dict[str, Any] = {}
    for field in layout.fields:
        if field.name in left:
            values[field.name] = _in(field, left.pop(field.name), Encoding.JSON, path)
        elif not field.optional:
            refuse(f"{path}{field.name}", "a value", "nothing")
    if layout.variant is not None:
        name, variant = layout.variant
        label = left.pop(name, None)
        body = next((c for _, known, c in variant.codes if known == label), None)
        if body is None:
            refuse(f"{path}{name}", f"a known {variant.name}", label)
        values[name] = _from_object(body, left, path)
    elif left:
        refuse(path, f"fields of {cls.__name__}", sorted(left))
    return values


def _in(field: FieldLayout, plain: Plain, encoding: Encoding, path: str) -> Any:
    if plain is None and field.optional:
        return None
    return field.from_plain(plain, encoding, f"{path}{field.name}" if path else field.name)


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
        if encoding is Encoding.JSON:
            return _from_object(cls, plain, prefix)
        return _from_array(cls, plain, prefix)

    return to_plain, from_plain
