"""scapy fields for MQTT 5: variable byte integers, text, properties (MQTT 5.0, sections 1.5 and 2.2.2)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Any

from scapy.fields import Field
from scapy.packet import Packet

LARGEST_VARIABLE = 268_435_455

PROPERTIES: dict[int, tuple[str, str]] = {
    0x01: ("payload_format_indicator", "byte"),
    0x02: ("message_expiry_interval", "four"),
    0x03: ("content_type", "text"),
    0x08: ("response_topic", "text"),
    0x09: ("correlation_data", "binary"),
    0x0B: ("subscription_identifier", "variable"),
    0x11: ("session_expiry_interval", "four"),
    0x12: ("assigned_client_identifier", "text"),
    0x13: ("server_keep_alive", "two"),
    0x15: ("authentication_method", "text"),
    0x16: ("authentication_data", "binary"),
    0x17: ("request_problem_information", "byte"),
    0x18: ("will_delay_interval", "four"),
    0x19: ("request_response_information", "byte"),
    0x1A: ("response_information", "text"),
    0x1C: ("server_reference", "text"),
    0x1F: ("reason_string", "text"),
    0x21: ("receive_maximum", "two"),
    0x22: ("topic_alias_maximum", "two"),
    0x23: ("topic_alias", "two"),
    0x24: ("maximum_qos", "byte"),
    0x25: ("retain_available", "byte"),
    0x26: ("user_property", "pair"),
    0x27: ("maximum_packet_size", "four"),
    0x28: ("wildcard_subscription_available", "byte"),
    0x29: ("subscription_identifier_available", "byte"),
    0x2A: ("shared_subscription_available", "byte"),
}
"""Each property's name and the encoding of its value (MQTT 5.0, 2.2.2.2)."""
MALFORMED = "malformed"
"""The name of the unreadable rest of properties, which keeps all its bytes."""
_NUMBERS = {name: number for number, (name, _) in PROPERTIES.items()}
_KINDS = dict(PROPERTIES.values())
_FIXED = {"byte": 1, "two": 2, "four": 4}

Property = tuple[str, Any]


class MalformedError(ValueError):
    """Bytes that MQTT 5 does not allow where they are."""


def write_variable(value: int) -> bytes:
    """Encode a variable byte integer (1.5.5). Raises MalformedError for a number that it cannot carry."""
    if not 0 <= value <= LARGEST_VARIABLE:
        raise MalformedError(f"{value}: expected 0 to {LARGEST_VARIABLE}")
    made = bytearray()
    while value > 0x7F:
        made.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*made, value])


def read_variable(data: bytes, start: int = 0) -> tuple[int, int]:
    """Decode a variable byte integer; returns it and its end. Raises MalformedError if there is no complete one."""
    value = 0
    for place, byte in enumerate(data[start : start + 4]):
        value |= (byte & 0x7F) << 7 * place
        if byte < 0x80:
            return value, start + place + 1
    raise MalformedError("no whole variable byte integer")


def write_binary(value: bytes | str) -> bytes:
    """Encode two bytes of length, then the bytes (1.5.4, 1.5.6)."""
    data = value.encode() if isinstance(value, str) else bytes(value)
    if len(data) > 0xFFFF:
        raise MalformedError(f"{len(data)} bytes: expected at most 65535")
    return struct.pack("!H", len(data)) + data


def read_binary(data: bytes, start: int = 0) -> tuple[bytes, int]:
    """Decode what `write_binary` encodes; returns the bytes and their end. Raises MalformedError if it is cut off."""
    end = start + 2 + int.from_bytes(data[start : start + 2], "big")
    if len(data) < start + 2 or len(data) < end:
        raise MalformedError("text or binary data that is cut off")
    return data[start + 2 : end], end


def write_properties(found: Iterable[Property]) -> bytes:
    """Encode properties, without their length."""
    return b"".join(_write_property(name, value) for name, value in found)


def _write_property(name: str, value: Any) -> bytes:
    if name == MALFORMED:
        return bytes(value)
    if name not in _NUMBERS:
        raise MalformedError(f"property {name!r}: expected one of {', '.join(_NUMBERS)}")
    kind = _KINDS[name]
    if kind in _FIXED:
        written = int(value).to_bytes(_FIXED[kind], "big")
    elif kind == "variable":
        written = write_variable(value)
    elif kind == "pair":
        written = write_binary(value[0]) + write_binary(value[1])
    else:
        written = write_binary(value)
    return write_variable(_NUMBERS[name]) + written


def read_properties(data: bytes) -> list[Property]:
    """Decode properties in order; from the first unreadable one on, the rest is a property named `malformed`."""
    found: list[Property] = []
    position = 0
    while position < len(data):
        try:
            name, value, position = _read_property(data, position)
        except MalformedError:
            return [*found, (MALFORMED, data[position:])]
        found.append((name, value))
    return found


def _read_property(data: bytes, start: int) -> tuple[str, Any, int]:
    number, at = read_variable(data, start)
    if number not in PROPERTIES or at != start + 1:
        raise MalformedError(f"property {number:#x}: unknown")
    name, kind = PROPERTIES[number]
    if kind in _FIXED:
        end = at + _FIXED[kind]
        if end > len(data):
            raise MalformedError(f"{name}: cut off")
        return name, int.from_bytes(data[at:end], "big"), end
    if kind == "variable":
        value, end = read_variable(data, at)
        if write_variable(value) != data[at:end]:
            raise MalformedError(f"{name}: longer than it needs to be")
        return name, value, end
    if kind == "pair":
        key, middle = _read_text(data, at)
        text, end = _read_text(data, middle)
        return name, (key, text), end
    if kind == "text":
        return name, *_read_text(data, at)
    return name, *read_binary(data, at)


def _read_text(data: bytes, start: int) -> tuple[str, int]:
    raw, end = read_binary(data, start)
    try:
        return raw.decode(), end
    except UnicodeDecodeError as error:
        raise MalformedError("text that is not UTF-8") from error


class VariableByteInteger(Field[Any, Any]):
    """A number in one to four bytes; None is written as 0."""

    __slots__: list[str] = []

    def __init__(self, name: str, default: int | None) -> None:
        super().__init__(name, default, "B")

    def addfield(self, pkt: Packet, s: bytes, val: Any) -> bytes:
        return s + write_variable(val or 0)

    def getfield(self, pkt: Packet, s: bytes) -> tuple[bytes, Any]:
        value, end = read_variable(s)
        return s[end:], value


class Binary(Field[Any, Any]):
    """Bytes after their length; accepts text too."""

    __slots__: list[str] = []

    def __init__(self, name: str, default: bytes = b"") -> None:
        super().__init__(name, default, "B")

    def any2i(self, pkt: Packet | None, x: Any) -> Any:
        return x.encode() if isinstance(x, str) else x

    def addfield(self, pkt: Packet, s: bytes, val: Any) -> bytes:
        return s + write_binary(val or b"")

    def getfield(self, pkt: Packet, s: bytes) -> tuple[bytes, Any]:
        value, end = read_binary(s)
        return s[end:], value


class Utf8String(Binary):
    """Text after its length; bytes that are not UTF-8 are kept as surrogates, so that none is lost."""

    __slots__: list[str] = []

    def __init__(self, name: str, default: str = "") -> None:
        Field.__init__(self, name, default, "B")

    def any2i(self, pkt: Packet | None, x: Any) -> Any:
        return x.decode(errors="surrogateescape") if isinstance(x, bytes) else x

    def addfield(self, pkt: Packet, s: bytes, val: Any) -> bytes:
        return s + write_binary((val or "").encode(errors="surrogateescape"))

    def getfield(self, pkt: Packet, s: bytes) -> tuple[bytes, Any]:
        value, end = read_binary(s)
        return s[end:], value.decode(errors="surrogateescape")


class Properties(Field[Any, Any]):
    """Properties after their length: a list of (name, value); the value of `user_property` is a pair of texts.

    It accepts a dict too. Unreadable bytes are kept as `("malformed", bytes)`.
    """

    __slots__: list[str] = []
    islist = 1
    ismutable = True

    def __init__(self, name: str = "properties") -> None:
        super().__init__(name, [], "B")

    def any2i(self, pkt: Packet | None, x: Any) -> Any:
        return list(x.items()) if isinstance(x, Mapping) else x

    def addfield(self, pkt: Packet, s: bytes, val: Any) -> bytes:
        body = write_properties(val or ())
        return s + write_variable(len(body)) + body

    def getfield(self, pkt: Packet, s: bytes) -> tuple[bytes, Any]:
        length, start = read_variable(s)
        if start + length > len(s):
            raise MalformedError("properties that are cut off")
        return s[start + length :], read_properties(s[start : start + length])

    def i2repr(self, pkt: Packet | None, x: Any) -> str:
        return ", ".join(f"{name} {value!r}" for name, value in x or ()) or "none"
