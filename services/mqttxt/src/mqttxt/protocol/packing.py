"""Packs the objects that are carried in pieces: compressed messages (RFC 1950), bounded before and after."""

from __future__ import annotations

import zlib
from typing import Any, TypeVar

from ..errors import PayloadError
from .cbor import MAX_PAYLOAD
from .codec import decode, encode

Message = TypeVar("Message")


def pack(message: Any, what: str) -> bytes:
    """The bytes of an object. Raises PayloadError for a field that cannot be carried, and for too long an object."""
    plain = encode(message)
    if len(plain) > MAX_PAYLOAD:
        raise PayloadError(f"{what}: expected at most {MAX_PAYLOAD} bytes before compression, got {len(plain)}")
    return zlib.compress(plain, level=9)


def unpack(cls: type[Message], data: bytes, what: str) -> Message:
    """The object of type `cls` in `data`. Raises PayloadError for any other data."""
    inflater = zlib.decompressobj()
    try:
        plain = inflater.decompress(data, MAX_PAYLOAD + 1)
    except zlib.error as error:
        raise PayloadError(f"{what}: {error}") from error
    if not inflater.eof or inflater.unused_data:
        raise PayloadError(f"{what}: expected one compressed object of at most {MAX_PAYLOAD} bytes")
    return decode(cls, plain)
